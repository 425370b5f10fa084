"""From grains to continuum: contacts, stress, fabric, coordination number."""

from dataclasses import dataclass

import numpy as np

from . import neighbours
from .aliasing import kernel, stays_out_of_line
from .packing import PAIRS_PER_GRAIN, Packing
from .small import determinant


@dataclass(frozen=True)
class Contacts:
    """The C touching pairs of a packing.

    pairs (C, 2) i < j; branches (C, d) from i to j, m; normals (C, d); overlaps (C,) m;
    stiffness (C,) k_n, N/m; normal_force (C,) compression positive, N; tangential on j, N, (C,)
    along (-n_y, n_x) for disks and (C, 3) for spheres; forces (C, d) on i, N (Desrues: f^{m/n}).
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
    pairs, _, grid = neighbours.allocate(
        packing.size, packing.dim, 4 * PAIRS_PER_GRAIN[packing.dim] * packing.size, False
    )
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
    lengths = np.linalg.norm(branches, axis=1)
    normals = branches / lengths[:, None]
    overlaps = pairs.reach[:count] - lengths
    normal = pairs.stiffness[:count] * overlaps - packing.law.cohesion
    tangential = _tangential_of(packing, i, j)
    on_j = normal[:, None] * normals
    on_j += tangential_vectors(normals, tangential)
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
    forces = np.zeros((len(i), *packing.tangential.shape[1:]))
    if len(known):
        found = known[order][place] == wanted
        forces[found] = packing.tangential[order][place][found]
    return forces


def tangential_vectors(normals: np.ndarray, tangential: np.ndarray) -> np.ndarray:
    """Tangential forces (C, d) from what a packing holds: along (-n_y, n_x) (C,), or (C, 3)."""
    if tangential.ndim == 2:
        return tangential
    return tangential[:, None] * np.column_stack([-normals[:, 1], normals[:, 0]])


def stress(packing: Packing, contacts: Contacts | None = None) -> np.ndarray:
    """Cauchy stress (d, d), Pa, tension positive: sum of f (x) b over V (Desrues eq. 27)."""
    contacts = contacts or touching(packing)
    return contacts.forces.T @ contacts.branches / packing.volume


def coordination_number(packing: Packing, contacts: Contacts | None = None) -> float:
    """Mean number of contacts of a grain, 2 C / N."""
    contacts = contacts or touching(packing)
    return 2.0 * len(contacts.pairs) / packing.size


def fabric(contacts: Contacts) -> np.ndarray:
    """phi (d, d): mean of n (x) n over the contacts (Guo-Zhao eq. 22); I / d without contacts."""
    dim = contacts.normals.shape[1]
    if len(contacts.normals) == 0:
        return np.eye(dim) / dim
    return contacts.normals.T @ contacts.normals / len(contacts.normals)


def fabric_anisotropy(phi: np.ndarray) -> np.ndarray:
    """Intensity of the anisotropy of phi (..., d, d).

    2D: F_a = sqrt(F_a : F_a / 2) with F_a = 4 (phi - I / 2), Guo-Zhao eq. 24-25. 3D: the same for
    E(n) = (1 + F_a : n n) / (4 pi), that is F_a = 15/2 (phi - I / 3) and sqrt(3/2 F_a : F_a).
    """
    dim = phi.shape[-1]
    factor, weight = (4.0, 0.5) if dim == 2 else (7.5, 1.5)
    deviator = factor * (phi - np.eye(dim) / dim)
    return np.sqrt(weight * (deviator**2).sum((-2, -1)))


def elastic_energy(packing: Packing, contacts: Contacts | None = None) -> float:
    """Energy stored in the contacts, J: sum of k_n d^2 / 2 + f_t^2 / (2 k_t); without cohesion."""
    contacts = contacts or touching(packing)
    energy = 0.5 * (contacts.stiffness * contacts.overlaps**2).sum()
    if packing.law.friction > 0 and packing.law.stiffness_ratio > 0:
        kt = packing.law.stiffness_ratio * contacts.stiffness
        squared = tangential_vectors(contacts.normals, contacts.tangential) ** 2
        energy += 0.5 * (squared.sum(1) / kt).sum()
    return float(energy)


@kernel
def measure(motion, pairs, cohesion, thickness, stress, fabric):
    """Stress and fabric (d, d) of a packing in the work space; returns (contacts, overlap).

    The same sums as `stress` and `fabric`, from the positions of this moment. `overlap` is the
    largest, as a share of the mean diameter of its two grains.
    """
    stays_out_of_line()
    box, position = motion.box, motion.position
    dim = box.shape[0]
    branch, force = np.zeros(3), np.zeros(3)
    stress[:] = 0.0
    fabric[:] = 0.0
    contacts, overlap = 0, 0.0
    for c in range(pairs.first[-1]):
        i, j = pairs.i[c], pairs.j[c]
        x = position[0, j] - position[0, i] + pairs.shift[0, c]
        y = position[1, j] - position[1, i] + pairs.shift[1, c]
        branch[0], branch[1] = box[0, 0] * x + box[0, 1] * y, box[1, 0] * x + box[1, 1] * y
        if dim == 3:
            z = position[2, j] - position[2, i] + pairs.shift[2, c]
            branch[0] += box[0, 2] * z
            branch[1] += box[1, 2] * z
            branch[2] = box[2, 0] * x + box[2, 1] * y + box[2, 2] * z
        squared = branch[0] ** 2 + branch[1] ** 2 + branch[2] ** 2
        length = squared**0.5
        if length >= pairs.reach[c]:
            continue
        normal = pairs.stiffness[c] * (pairs.reach[c] - length)
        if cohesion is not None:
            normal -= cohesion
        if dim == 2:
            force[0] = (normal * branch[0] - pairs.tangential[0, c] * branch[1]) / length
            force[1] = (normal * branch[1] + pairs.tangential[0, c] * branch[0]) / length
        else:
            for a in range(dim):
                force[a] = normal * branch[a] / length + pairs.tangential[a, c]
        for a in range(dim):
            for b in range(dim):
                stress[a, b] -= force[a] * branch[b]
                fabric[a, b] += branch[a] * branch[b] / squared
        contacts += 1
        overlap = max(overlap, (pairs.reach[c] - length) / pairs.reach[c])
    stress /= determinant(box) * thickness
    if contacts > 0:
        fabric /= contacts
    else:
        for a in range(dim):
            fabric[a, a] = 1.0 / dim
    return contacts, overlap
