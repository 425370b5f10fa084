"""Inf-sup constants of the mixed spaces (u, nu, lambda) of the second gradient.

For a multiplier lambda, s_h(lambda) is the largest of int lambda : (grad u - nu) over discrete
(u, nu) with |grad u|^2 + |nu|^2 + |grad nu|^2 = 1, and s(lambda) the same over all functions (here
of two degrees more). The space is stable where the smallest s_h / s stays away from zero under
refinement: then every multiplier that the continuum feels is felt by the discrete functions too.
One row i of nu_ij is enough, as the rows do not meet. Prints one JSON object as its last line.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import assemble_matrix
from mpi4py import MPI
from scipy.linalg import eigh
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]
from femxdem_fenicsx import script  # noqa: E402
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
    matrix = assemble_matrix(fem.form(integrand * ufl.dx))
    matrix.assemble()
    return csr_matrix(matrix.getValuesCSR()[::-1], shape=matrix.getSize())


#: Element and multiplier; the first three are those of the program.
CASES = [
    ("Q8", "P0"), ("Q9", "P0"), ("T6", "P1"), ("T6", "P0"), ("Q8", "P1"), ("Q8", "dP1"),
    ("T6", "dP1"),
]  # fmt: skip
CASES_3D = [("H27", "P0"), ("T10", "P1"), ("T10", "P0")]


def main(comm: MPI.Comm) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="coarse meshes alone")
    args = script.parse(parser, comm)
    result = []
    for cases, counts in ((CASES, (2, 4, 8, 16)), (CASES_3D, (1, 2, 3))):
        for name, multiplier in cases:
            constants = {
                str(n): constant(name, n, multiplier, 0.2 if len(counts) == 4 else 0.1)
                for n in counts[: 2 if args.quick else None]
            }
            result.append({"element": name, "multiplier": multiplier, "constants": constants})
    if comm.rank == 0:
        print(json.dumps({"cases": result}))
    return 0


if __name__ == "__main__":
    script.run(main)
