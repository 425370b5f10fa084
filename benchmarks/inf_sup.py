"""Inf-sup constants of the mixed spaces (u, nu, lambda) of the second gradient.

For a multiplier lambda, s_h(lambda) is the largest of int lambda : (grad u - nu) over discrete
(u, nu) with |grad u|^2 + |nu|^2 + |grad nu|^2 = 1, and s(lambda) the same over all functions (here
of two degrees more). The space is stable where the smallest s_h / s stays away from zero under
refinement: then every multiplier that the continuum feels is felt by the discrete functions too.
One row i of nu_ij is enough, as the rows do not meet. u is zero on the bottom, or on two plates, on
the bottom and on the top: then, with a linear micro-strain, one multiplier is felt less and less,
and with periodic sides and an even number of columns not at all. Prints one JSON object as its last
line.
"""

import argparse
import json
import sys
from itertools import product
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix
from mpi4py import MPI
from scipy.linalg import eigh
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import splu

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]
from femxdem_fenicsx import script  # noqa: E402
from femxdem_fenicsx.fem import _dolfinx  # noqa: E402
from femxdem_fenicsx.fem.elements import MICRO_STRAINS, element  # noqa: E402
from meshes.box import box  # noqa: E402
from meshes.rectangle import rectangle  # noqa: E402

#: Of the multiplier, beside the element's own: piecewise constant, linear, continuous linear.
MULTIPLIERS = {"P0": ("DG", 0), "dP1": ("DG", 1), "P1": ("Lagrange", 1)}


def constant(
    name: str,
    cells: int,
    multiplier: str = "P0",
    distortion: float = 0.0,
    *,
    sides: str | None = None,
    micro_strain: str = "linear",
) -> float:
    """Smallest s_h / s for an element on the unit square or cube with so many cells each way.

    u is zero on the bottom; where `sides` (2D) is given, "free" or "periodic", on the top too.
    """
    kind = element(name)
    d = kind.dim
    if d == 2:
        domain = rectangle(MPI.COMM_SELF, 1.0, 1.0, cells, cells, kind, distortion)
    else:
        domain = box(MPI.COMM_SELF, (1.0,) * 3, (cells,) * 3, kind, distortion)
    family, degree = MULTIPLIERS[multiplier]
    Lambda = _space(domain, family, kind.cell, degree, (d,))
    U = _dolfinx.functionspace(domain, kind.nodal(()))
    if micro_strain == "quadratic":
        N = _dolfinx.functionspace(domain, kind.nodal((d,)))
    else:
        N = _space(domain, "Lagrange", kind.cell, 1, (d,))
    coarse = _felt(U, N, Lambda, sides)
    U = _space(domain, "Lagrange", kind.cell, kind.degree + 2)
    N = _space(domain, "Lagrange", kind.cell, 3 if micro_strain == "linear" else 4, (d,))
    fine = _felt(U, N, Lambda, sides)
    return float(np.sqrt(max(eigh(coarse, fine, eigvals_only=True)[0], 0.0)))


def _space(domain, family: str, cell: str, degree: int, shape: tuple[int, ...] = ()):
    return _dolfinx.functionspace(domain, _dolfinx._element(family, cell, degree, shape))


def _felt(U, N, Lambda, sides: str | None) -> np.ndarray:
    """s^2 as a quadratic form of the multipliers' dofs."""
    u, w = ufl.TrialFunction(U), ufl.TestFunction(U)
    nu, eta = ufl.TrialFunction(N), ufl.TestFunction(N)
    mu = ufl.TestFunction(Lambda)
    plates = (0.0, 1.0) if sides else (0.0,)
    total = 0.0
    for space, fixed, norm, constraint in (
        (U, plates, ufl.inner(ufl.grad(u), ufl.grad(w)), ufl.inner(mu, ufl.grad(u))),
        (N, (), ufl.inner(nu, eta) + ufl.inner(ufl.grad(nu), ufl.grad(eta)), ufl.inner(mu, nu)),
    ):
        T = _independent(space, fixed, sides == "periodic")
        X, B = T.T @ _matrix(norm) @ T, _matrix(constraint) @ T
        total = total + B @ splu(X.tocsc()).solve(B.T.toarray())
    return 0.5 * (total + total.T)


def _independent(space, fixed: tuple[float, ...], periodic: bool) -> csr_matrix:
    """All dofs (rows) of functions that vanish at the fixed heights, by those that are left."""
    place, block = space.tabulate_dof_coordinates().copy(), space.dofmap.index_map_bs
    height = place[:, space.mesh.geometry.dim - 1]
    left = np.repeat(~np.isclose(height[:, None], np.array(fixed)).any(axis=1), block)
    if periodic:
        place[np.isclose(place[:, 0], 1.0), 0] = 0.0
    _, same = np.unique(place.round(9), axis=0, return_inverse=True)
    of = (block * same.reshape(-1, 1) + np.arange(block)).ravel()
    T = coo_matrix((np.ones(len(of)), (np.arange(len(of)), of))).tocsr()
    return T[:, np.unique(of[left])]


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
    for sides, micro_strain in product(("free", "periodic"), MICRO_STRAINS):
        between = {"sides": sides, "micro_strain": micro_strain}
        constants = {str(n): constant("Q8", n, **between) for n in (2, 3, 4, 7, 8)}
        result.append({"element": "Q8", "multiplier": "P0", **between, "constants": constants})
    if comm.rank == 0:
        print(json.dumps({"cases": result}))
    return 0


if __name__ == "__main__":
    script.run(main)
