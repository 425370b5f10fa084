"""PSTLO, the prestressed truss-like operator (Argilaga section 5.2 and appendix B).

The grains are the nodes of a lattice, with rotations; contacts persist and are elastic. Of a
contact, with n from i to j, l = |b|, lever = l / (R_i + R_j) and the sum s = w_i + w_j of the rim
velocities
R theta, a small motion changes the force F on j and the moment M / R that slows both grains by

    dF = -k_n n (n.db) + f_n dn - (T.dn) n + dT,       dn = (I - n n) db / l,
    dT = -k_t ((I - n n) db - lever s x n) + twist n x T,
    dM = d(lever n x T)

(eq. B.4-B.11, where the contact divides the branch in the ratio of the radii). The twist, in 3D, is
the mean rotation of both grains about n (Desrues eq. 24). Rolling resistance, where the law has it,
is a spring k_r between the rotations of both grains about the axes in the contact plane.
"""

import numpy as np

from ..aliasing import kernel
from ..response import Response
from . import block_ldl
from .kao import kruyt_augmented
from .network import network, objective, strains

#: Stiffness to the ground that every grain gets, over the mean k_n. It holds what nothing else does
#: (the packing as a whole, grains without contacts) and is far below all else.
GROUND = 1e-8
#: The same for the rotations of spheres: one between two contacts can spin about the line through
#: them, and what would hold it there is nearly nothing.
GROUND_OF_SPINS = 1e-4
#: Least contacts of a grain that can be held by them: with friction in 2D and 3D, without.
HELD_BY = {(2, True): 2, (3, True): 2, (2, False): 3, (3, False): 4}
#: On the residual of the linear equations, over the forces of the affine motion.
TOLERANCE = 1e-6
MOST_REFINEMENTS = 50


def prestressed_truss(
    response: Response, F: np.ndarray, packings: np.ndarray | None = None
) -> np.ndarray:
    """PSTLO: the exact derivative of a packing in which nothing slides, opens or closes (eq. 23).

    Of all packings, or of those whose numbers are given (k,); F (B, d, d), C (B or k, d, d, d, d).

    Grains with too few contacts to be held by them move along and bear nothing. Strains alone are
    solved for: a rotation turns the stress. A packing whose equations cannot be solved (it is about
    to collapse) gets KAO.
    """
    packings = np.arange(response.size) if packings is None else packings
    B, dim = len(packings), F.shape[-1]
    basis = strains(dim)
    columns = np.zeros((B, len(basis), dim, dim))
    stress = np.zeros((B, dim, dim))
    left = np.zeros(B)
    radius = response.material.radius
    turning = response.material.friction is not None
    least = HELD_BY[dim, turning]
    unit = (0,) * (dim if not turning else 3 * dim - 3)

    def one(k: int) -> None:
        contacts = network(response, packings[k])
        stress[k] = contacts.stress
        left[k] = _solve(unit, least, radius, basis, *contacts, columns[k])

    response.for_each(one, np.arange(B))
    dilation = np.einsum("sii->s", basis)
    C = objective(columns - dilation[:, None, None] * stress[:, None], stress)
    unsolved = ~(left < TOLERANCE)
    if unsolved.any():
        C[unsolved] = kruyt_augmented(response, F)[packings[unsolved]]
    return C


@kernel
def _solve(
    unit, least, radius, basis, i, j, branch, reach, k_n, k_t, f_n, tangential, k_r, volume, columns
):  # fmt: skip
    """Change of the stress per unit of each strain of `basis` into `columns`; the residual left."""
    dim, size, m = branch.shape[1], len(radius), len(unit)
    held = _held(least, size, i, j)
    S, twist = np.zeros((len(i), m, m)), np.zeros((len(i), m))
    ground = np.full(m, GROUND * k_n.mean() if len(i) else 1.0)
    if dim == 3:
        ground[3:] *= GROUND_OF_SPINS / GROUND
    for c in range(len(i)):
        if held[i[c]] and held[j[c]]:
            _stiffness(c, branch, reach, k_n, k_t, f_n, tangential, unit, S, twist)
    place, first, row = block_ldl.eliminate(size, i, j)
    diagonal = np.zeros((size, m, m))
    value = np.empty((len(i), m, m))
    column = np.empty((len(i), 2), np.int64)
    following = np.full(size + len(i), -1)
    for k in range(size):
        for p in range(m):
            diagonal[k, p, p] = ground[p]
    for c in range(len(i)):
        pi, pj = place[i[c]], place[j[c]]
        column[c, 0], column[c, 1] = min(pi, pj), max(pi, pj)
        following[size + c] = following[column[c, 0]]
        following[column[c, 0]] = c
        for p in range(m):
            for q in range(m):
                symmetric = 0.5 * (S[c, p, q] + S[c, q, p])
                flip_p, flip_q = 1.0 if p >= dim else -1.0, 1.0 if q >= dim else -1.0
                diagonal[pi, p, q] += flip_p * flip_q * symmetric
                diagonal[pj, p, q] += symmetric
                value[c, p, q] = symmetric * (flip_q if pj > pi else flip_p)
        for p in range(dim, m):
            for q in range(dim, m):
                rolling = k_r[c] * _across(c, p - dim, q - dim, branch)
                diagonal[pi, p, q] += rolling / radius[i[c]] ** 2
                diagonal[pj, p, q] += rolling / radius[j[c]] ** 2
                value[c, p, q] -= rolling / (radius[i[c]] * radius[j[c]])
    below, pivot = np.empty((len(row), m, m)), np.empty((size, m, m))
    block_ldl.factorise(diagonal, column, value, following, first, row, unit, below, pivot)

    s = len(basis)
    motion, scale = np.zeros((size, m, s)), 0.0
    residual, ordered = np.zeros((size, m, s)), np.zeros((size, m, s))
    forces, moved = np.empty((m, s)), np.empty((m, s))
    for round in range(MOST_REFINEMENTS):
        for p in range(m):
            residual[:, p] = -ground[p] * motion[:, p]
        columns[:] = 0.0
        for c in range(len(i)):
            a, b = i[c], j[c]
            if not (held[a] and held[b]):
                continue
            _moved(a, b, c, branch, basis, motion, unit, moved)
            for p in range(m):
                for v in range(s):
                    total = 0.0
                    for q in range(m):
                        total += S[c, p, q] * moved[q, v]
                    forces[p, v] = total
                    if round == 0:
                        scale += total**2
            if m > dim and dim == 3:
                _add_twist(a, b, c, branch, radius, twist, motion, forces)
            for p in range(m):
                for v in range(s):
                    flip = 1.0 if p >= dim else -1.0
                    residual[a, p, v] -= flip * forces[p, v]
                    residual[b, p, v] -= forces[p, v]
            if k_r[c] > 0.0:
                _add_rolling(a, b, c, branch, radius, k_r, motion, residual)
            _add_stress(c, branch, f_n, tangential, forces, moved, columns)
        squared = 0.0
        for g in range(size):
            for p in range(m):
                for v in range(s):
                    squared += residual[g, p, v] ** 2
        left = np.sqrt(squared / max(scale, 1e-300))
        if left < TOLERANCE or not np.isfinite(left):
            break
        for g in range(size):
            ordered[place[g]] = residual[g]
        block_ldl.solve(first, row, below, pivot, unit, ordered)
        for g in range(size):
            motion[g] += ordered[place[g]]
    columns /= volume
    return left


@kernel
def _held(least, size, i, j):
    """Grains that have enough contacts with others of their kind, (N,) bool."""
    held = np.ones(size, np.bool_)
    changed = True
    while changed:
        contacts = np.zeros(size, np.int64)
        for c in range(len(i)):
            if held[i[c]] and held[j[c]]:
                contacts[i[c]] += 1
                contacts[j[c]] += 1
        changed = False
        for g in range(size):
            if held[g] and contacts[g] < least:
                held[g] = False
                changed = True
    return held


@kernel
def _stiffness(c, branch, reach, k_n, k_t, f_n, tangential, unit, S, twist):
    """(-dF, dM) = S (db, s) + twist (mean rotation about n) of contact c, m x m and (m,)."""
    dim, m = branch.shape[1], len(unit)
    nx, ny = branch[c, 0], branch[c, 1]
    nz = branch[c, 2] if dim == 3 else 0.0
    tx, ty = tangential[c, 0], tangential[c, 1]
    tz = tangential[c, 2] if dim == 3 else 0.0
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    n, T = (nx, ny, nz), (tx, ty, tz)
    moment = (ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx)  # n x T
    n_cross = ((0.0, -nz, ny), (nz, 0.0, -nx), (-ny, nx, 0.0))
    lever = length / reach[c]
    for p in range(dim):
        twist[c, p] = -moment[p]
        for q in range(dim):
            along = n[p] * n[q]
            across = (1.0 if p == q else 0.0) - along
            S[c, p, q] = k_n[c] * along + (k_t[c] - f_n[c] / length) * across
            S[c, p, q] += n[p] * T[q] / length
    axis = 2 if dim == 2 else 0  # a disk spins about z alone
    for p in range(m - dim):
        a = p + axis
        twist[c, dim + p] = -lever * T[a]
        for q in range(dim):
            S[c, q, dim + p] = k_t[c] * lever * n_cross[q][a]
            # of (I - n n) db x T, which is along n in 3D and nothing in 2D
            turned = n[a] * moment[q] if dim == 3 else 0.0
            S[c, dim + p, q] = (n[q] * moment[a] - turned) / reach[c]
            S[c, dim + p, q] -= k_t[c] * lever * n_cross[a][q]
        for q in range(m - dim):
            across = (1.0 if p == q else 0.0) - n[a] * n[q + axis]
            S[c, dim + p, dim + q] = k_t[c] * lever**2 * across


@kernel
def _moved(i, j, c, branch, basis, motion, unit, moved):
    """(db, s) of contact c for every strain, (m, s)."""
    dim = branch.shape[1]
    for v in range(len(basis)):
        for p in range(len(unit)):
            if p < dim:
                moved[p, v] = motion[j, p, v] - motion[i, p, v]
                for q in range(dim):
                    moved[p, v] += basis[v, p, q] * branch[c, q]
            else:
                moved[p, v] = motion[i, p, v] + motion[j, p, v]


@kernel
def _add_twist(i, j, c, branch, radius, twist, motion, forces):
    """Of spheres: the tangential force turns with the mean rotation about the normal."""
    length = np.sqrt(branch[c, 0] ** 2 + branch[c, 1] ** 2 + branch[c, 2] ** 2)
    for v in range(forces.shape[1]):
        mean = 0.0
        for p in range(3):
            mean += (
                0.5
                * branch[c, p]
                / length
                * (motion[i, 3 + p, v] / radius[i] + motion[j, 3 + p, v] / radius[j])
            )
        for p in range(6):
            forces[p, v] += twist[c, p] * mean


@kernel
def _across(c, p, q, branch):
    """Component of I - n n of contact c, along which spheres roll; 1 for disks."""
    if branch.shape[1] == 2:
        return 1.0
    squared = branch[c, 0] ** 2 + branch[c, 1] ** 2 + branch[c, 2] ** 2
    return (1.0 if p == q else 0.0) - branch[c, p] * branch[c, q] / squared


@kernel
def _add_rolling(i, j, c, branch, radius, k_r, motion, residual):
    """Moments of the rolling springs, k_r times the rotation of j against i, over R."""
    dim, m = branch.shape[1], motion.shape[1]
    for v in range(motion.shape[2]):
        for p in range(dim, m):
            moment = 0.0
            for q in range(dim, m):
                turned = motion[j, q, v] / radius[j] - motion[i, q, v] / radius[i]
                moment += k_r[c] * _across(c, p - dim, q - dim, branch) * turned
            residual[i, p, v] += moment / radius[i]
            residual[j, p, v] -= moment / radius[j]


@kernel
def _add_stress(c, branch, f_n, tangential, forces, moved, columns):
    """Volume times the change of the stress, -F b / V, without that of V (s, d, d)."""
    dim = branch.shape[1]
    squared = 0.0
    for p in range(dim):
        squared += branch[c, p] ** 2
    for p in range(dim):
        force = f_n[c] * branch[c, p] / np.sqrt(squared) + tangential[c, p]
        for q in range(dim):
            for v in range(len(columns)):
                columns[v, p, q] += forces[p, v] * branch[c, q] - force * moved[q, v]
