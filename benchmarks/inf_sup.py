"""Inf-sup constants of the mixed spaces (u, nu, lambda) of the second gradient.

For a multiplier lambda, s_h(lambda) is the largest of int lambda : (grad u - nu) over discrete
(u, nu) with |grad u|^2 + |nu|^2 + |grad nu|^2 = 1, and s(lambda) the same over all functions (here
of two degrees more). The space is stable where the smallest s_h / s stays away from zero under
refinement: then every multiplier that the continuum feels is felt by the discrete functions too.
One row i of nu_ij is enough, as the rows do not meet. Prints one JSON object as its last line.
"""

import sys
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.linalg import eigh
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]
from femxdem_fenicsx.fem import _dolfinx  # noqa: E402
from femxdem_fenicsx.fem.elements import element  # noqa: E402
from meshes.box import box  # noqa: E402
from meshes.rectangle import rectangle  # noqa: E402

#: Of the multiplier, beside the element's own: piecewise constant, linear, continuous linear.
MULTIPLIERS = {"P0": ("DG", 0), "dP1": ("DG", 1), "P1": ("Lagrange", 1)}


def constant(name: str, cells: int, multiplier: str = "P0", distortion: float = 0.0) -> float:
    """Smallest s_h / s for an element on the unit square or cube with so many cells each way.

    u is zero on the bottom.
    """
    kind = element(name)
    d = kind.dim
    if d == 2:
        domain = rectangle(MPI.COMM_SELF, 1.0, 1.0, cells, cells, kind, distortion)
    else:
        domain = box(MPI.COMM_SELF, (1.0,) * 3, (cells,) * 3, kind, distortion)
    family, degree = MULTIPLIERS[multiplier]
    Lambda = _space(domain, family, kind.cell, degree, (d,))
    if name == "Q8":
        U = _dolfinx.functionspace(domain, _dolfinx.serendipity_element())
    else:
        U = _space(domain, "Lagrange", kind.cell, kind.degree)
    coarse = _felt(domain, U, _space(domain, "Lagrange", kind.cell, 1, (d,)), Lambda)
    U = _space(domain, "Lagrange", kind.cell, kind.degree + 2)
    fine = _felt(domain, U, _space(domain, "Lagrange", kind.cell, 3, (d,)), Lambda)
    return float(np.sqrt(max(eigh(coarse, fine, eigvals_only=True)[0], 0.0)))


def _space(domain, family: str, cell: str, degree: int, shape: tuple[int, ...] = ()):
    return _dolfinx.functionspace(domain, _dolfinx._element(family, cell, degree, shape))


def _felt(domain, U, N, Lambda) -> np.ndarray:
    """s^2 as a quadratic form of the multipliers' dofs."""
    u, w = ufl.TrialFunction(U), ufl.TestFunction(U)
    nu, eta = ufl.TrialFunction(N), ufl.TestFunction(N)
    mu = ufl.TestFunction(Lambda)
    dim = domain.topology.dim
    floor = mesh.locate_entities_boundary(domain, dim - 1, lambda x: x[dim - 1] < 1e-12)
    fixed = fem.locate_dofs_topological(U, dim - 1, floor)
    free = np.setdiff1d(np.arange(U.dofmap.index_map.size_global), fixed)
    total = 0.0
    for norm, constraint, kept in (
        (ufl.inner(ufl.grad(u), ufl.grad(w)), ufl.inner(mu, ufl.grad(u)), free),
        (ufl.inner(nu, eta) + ufl.inner(ufl.grad(nu), ufl.grad(eta)), ufl.inner(mu, nu), None),
    ):
        X, B = _matrix(norm), _matrix(constraint)
        if kept is not None:
            X, B = X[kept][:, kept], B[:, kept]
        total = total + B @ splu(X.tocsc()).solve(B.T.toarray())
    return 0.5 * (total + total.T)


def _matrix(integrand) -> csr_matrix:
    matrix = dolfinx_matrix(fem.form(integrand * ufl.dx))
    return csr_matrix(matrix.getValuesCSR()[::-1], shape=matrix.getSize())


def dolfinx_matrix(form):
    from dolfinx.fem.petsc import assemble_matrix

    matrix = assemble_matrix(form)
    matrix.assemble()
    return matrix


if __name__ == "__main__":
    cases = [("Q8", m) for m in ("P0", "dP1", "P1")] + [
        ("Q9", "P0"),
        ("Q9", "P1"),
        ("T6", "P0"),
        ("T6", "P1"),
        ("T6", "dP1"),
    ]
    for name, m in cases:
        print(
            name,
            m,
            [round(constant(name, n, m, 0.2), 5) for n in (2, 3, 4, 6, 8, 12, 16)],
            flush=True,
        )
    for name in ("H27", "T10"):
        print(name, "P0", [round(constant(name, n, "P0"), 4) for n in (1, 2, 3)], flush=True)
