"""From grains to continuum: contacts, stress, fabric, coordination number."""

from dataclasses import dataclass

import numpy as np

from . import neighbours
from .aliasing import kernel
from .packing import PAIRS_PER_GRAIN, Packing


@dataclass(frozen=True)
class Contacts:
    """The C touching pairs of a packing.

    pairs (C, 2) i < j; branches (C, 2) from i to j, m; normals (C, 2); overlaps (C,) m;
    stiffness (C,) k_n, N/m; normal_force (C,) compression positive, N; tangential (C,) N along
    (-n_y, n_x) on j; forces (C, 2) on i, N (Desrues: f^{m/n}).
    """

    pairs: np.ndarray
    branches: np.ndarray
    normals: np.ndarray
    overlaps: np.ndarray
    stiffness: np.ndarray
    normal_force: np.ndarray
    tangential: np.ndarray
    forces: np.ndarray


def touching(packing: Packing) -> Contacts:
    """All contacts of the packing as it stands (no viscous forces)."""
    material = packing.material
    pairs, _, grid = neighbours.allocate(packing.size, 4 * PAIRS_PER_GRAIN * packing.size, False)
    count = neighbours.build(
        packing.box, packing.positions.T.copy(), packing.radii, material.inverse_mass,
        material.stiffness, material.modulus, None, 0.0, pairs, grid,
    )  # fmt: skip
    if count < 0:
        raise ValueError("touching: far more contacts than grains; the packing is not physical")
    i, j = pairs.i[:count].astype(np.int64), pairs.j[:count].astype(np.int64)
    branches = (
        packing.positions[j] - packing.positions[i] + pairs.shift[:, :count].T
    ) @ packing.box.T
    lengths = np.hypot(*branches.T)
    normals = branches / lengths[:, None]
    overlaps = pairs.reach[:count] - lengths
    normal = pairs.stiffness[:count] * overlaps - packing.law.cohesion
    tangential = _tangential_of(packing, i, j)
    on_j = normal[:, None] * normals
    on_j += tangential[:, None] * np.column_stack([-normals[:, 1], normals[:, 0]])
    return Contacts(
        np.column_stack([i, j]), branches, normals, overlaps, pairs.stiffness[:count].copy(),
        normal, tangential, -on_j,
    )  # fmt: skip


def _tangential_of(packing: Packing, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Tangential forces of the pairs (i, j), zero where the packing holds none."""
    known = packing.contacts[:, 0].astype(np.int64) * packing.size + packing.contacts[:, 1]
    order = np.argsort(known)
    wanted = i * packing.size + j
    place = np.searchsorted(known[order], wanted)
    place[place == len(known)] = 0
    if len(known) == 0:
        return np.zeros(len(i))
    found = known[order][place] == wanted
    return np.where(found, packing.tangential[order][place], 0.0)


def stress(packing: Packing, contacts: Contacts | None = None) -> np.ndarray:
    """Cauchy stress (2, 2), Pa, tension positive: sum of f (x) b over V (Desrues eq. 27)."""
    contacts = contacts or touching(packing)
    return contacts.forces.T @ contacts.branches / packing.volume


def coordination_number(packing: Packing, contacts: Contacts | None = None) -> float:
    """Mean number of contacts of a grain, 2 C / N."""
    contacts = contacts or touching(packing)
    return 2.0 * len(contacts.pairs) / packing.size


def fabric(contacts: Contacts) -> np.ndarray:
    """phi (2, 2): mean of n (x) n over the contacts (Guo-Zhao eq. 22); I / 2 without contacts."""
    if len(contacts.normals) == 0:
        return np.eye(2) / 2
    return contacts.normals.T @ contacts.normals / len(contacts.normals)


def fabric_anisotropy(phi: np.ndarray) -> np.ndarray:
    """F_a = sqrt(F_a : F_a / 2) with F_a = 4 (phi - I / 2), Guo-Zhao eq. 24-25; phi (..., 2, 2)."""
    deviator = 4.0 * (phi - np.eye(2) / 2)
    return np.sqrt(0.5 * (deviator**2).sum((-2, -1)))


def elastic_energy(packing: Packing, contacts: Contacts | None = None) -> float:
    """Energy stored in the contacts, J: sum of k_n d^2 / 2 + f_t^2 / (2 k_t); without cohesion."""
    contacts = contacts or touching(packing)
    energy = 0.5 * (contacts.stiffness * contacts.overlaps**2).sum()
    if packing.law.friction > 0 and packing.law.stiffness_ratio > 0:
        kt = packing.law.stiffness_ratio * contacts.stiffness
        energy += 0.5 * (contacts.tangential**2 / kt).sum()
    return float(energy)


@kernel
def measure(motion, pairs, cohesion, thickness, stress, fabric):
    """Stress and fabric (2, 2) of a packing in the work space; returns (contacts, overlap).

    The same sums as `stress` and `fabric`, from the positions of this moment. `overlap` is the
    largest, as a share of the mean diameter of its two grains.
    """
    box, position = motion.box, motion.position
    stress[:] = 0.0
    fabric[:] = 0.0
    contacts, overlap = 0, 0.0
    for c in range(pairs.first[-1]):
        i, j = pairs.i[c], pairs.j[c]
        sx = position[0, j] - position[0, i] + pairs.shift[0, c]
        sy = position[1, j] - position[1, i] + pairs.shift[1, c]
        bx, by = box[0, 0] * sx + box[0, 1] * sy, box[1, 0] * sx + box[1, 1] * sy
        length = (bx * bx + by * by) ** 0.5
        if length >= pairs.reach[c]:
            continue
        nx, ny = bx / length, by / length
        normal = pairs.stiffness[c] * (pairs.reach[c] - length)
        if cohesion is not None:
            normal -= cohesion
        fx = normal * nx - pairs.tangential[c] * ny
        fy = normal * ny + pairs.tangential[c] * nx
        stress[0, 0] -= fx * bx
        stress[0, 1] -= fx * by
        stress[1, 0] -= fy * bx
        stress[1, 1] -= fy * by
        fabric[0, 0] += nx * nx
        fabric[0, 1] += nx * ny
        fabric[1, 1] += ny * ny
        contacts += 1
        overlap = max(overlap, (pairs.reach[c] - length) / pairs.reach[c])
    stress /= (box[0, 0] * box[1, 1] - box[0, 1] * box[1, 0]) * thickness
    fabric[1, 0] = fabric[0, 1]
    if contacts > 0:
        fabric /= contacts
    else:
        fabric[0, 0] = fabric[1, 1] = 0.5
    return contacts, overlap
