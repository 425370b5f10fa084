"""From grains to continuum: contacts, stress, fabric, coordination number."""

import math
from dataclasses import dataclass

import numpy as np

from . import neighbours
from .aliasing import kernel
from .contacts.interface import (
    attraction,
    elastic_force,
    normal_force,
    stiffnesses,
    strained_overlap,
)
from .packing import PAIRS_PER_GRAIN, Packing
from .reproducible import product
from .small import determinant


@dataclass(frozen=True)
class Contacts:
    """The C pairs of a packing that touch or are held by a bond.

    pairs (C, 2) i < j; branches (C, d) from i to j, m; normals (C, d); overlaps (C,) m, negative
    in a stretched bond; stiffness and tangential_stiffness (C,), df_n / du_n and df_t / du_t, N/m,
    the latter without regard to friction; normal_force (C,) compression positive, N; tangential on
    j, N, (C,) along (-n_y, n_x) for disks and (C, 3) for spheres; forces (C, d) on i, N (Desrues:
    f^{m/n}); coefficients (C,) of the contact law (`contacts.interface`); rolling moment on j, N m,
    like tangential, or None; bonded (C,) 1 or 0, or None.
    """

    pairs: np.ndarray
    branches: np.ndarray
    normals: np.ndarray
    overlaps: np.ndarray
    stiffness: np.ndarray
    normal_force: np.ndarray
    tangential: np.ndarray
    forces: np.ndarray
    tangential_stiffness: np.ndarray
    coefficients: np.ndarray
    rolling: np.ndarray | None = None
    bonded: np.ndarray | None = None


def touching(packing: Packing) -> Contacts:
    """All contacts of the packing as it stands (no viscous forces)."""
    material, law = packing.material, packing.law
    pairs, _, grid = neighbours.allocate(
        packing.size, packing.dim, 4 * PAIRS_PER_GRAIN[packing.dim] * packing.size, False
    )
    count = neighbours.build(
        packing.box, packing.positions.T.copy(), packing.radii, material.inverse_mass,
        material.law, None, material.skin if law.bonds is not None else 0.0, pairs, grid,
    )  # fmt: skip
    if count < 0:
        raise ValueError("touching: far more contacts than grains; the packing is not physical")
    i, j = pairs.i[:count].astype(np.int64), pairs.j[:count].astype(np.int64)
    apart = packing.positions[j] - packing.positions[i] + pairs.shift[:, :count].T
    branches = product(apart, packing.box.T)
    lengths = np.linalg.norm(branches, axis=1)
    normals = branches / lengths[:, None]
    overlaps = pairs.reach[:count] - lengths
    held = {
        name: _held_by(packing, getattr(packing, name), i, j)
        for name in ("tangential", "rolling", "bonded")
    }
    contact = overlaps > 0 if law.bonds is None else (overlaps > 0) | (held["bonded"] > 0)
    magnitude, k_n, k_t = elastic_response(
        material.law, pairs.coefficient[:count], np.where(contact, np.abs(overlaps), 0.0)
    )
    normal = np.copysign(magnitude, overlaps) - law.cohesion * (overlaps > 0)
    on_j = normal[:, None] * normals
    on_j += tangential_vectors(normals, held["tangential"])
    everything = {
        "pairs": np.column_stack([i, j]), "branches": branches, "normals": normals,
        "overlaps": overlaps, "stiffness": k_n, "normal_force": normal, "forces": -on_j,
        "tangential_stiffness": k_t, "coefficients": pairs.coefficient[:count], **held,
    }  # fmt: skip
    return Contacts(
        **{name: None if of is None else of[contact] for name, of in everything.items()}
    )


@kernel
def elastic_response(law, coefficients, overlaps):
    """(f_n, k_n, k_t), each (C,), at overlaps (C,) that are zero or more."""
    forces, k_n, k_t = np.zeros((3, len(overlaps)))
    for c in range(len(overlaps)):
        forces[c] = normal_force(law, coefficients[c], overlaps[c])
        k_n[c], k_t[c] = stiffnesses(law, coefficients[c], overlaps[c])
    return forces, k_n, k_t


def largest_overlap(contacts: Contacts, packing: Packing) -> float:
    """Of all contacts, over the mean diameter of its grains; 0 without contacts."""
    i, j = contacts.pairs.T
    return float((contacts.overlaps / (packing.radii[i] + packing.radii[j])).max(initial=0.0))


def unbalance_of(contacts: Contacts, packing: Packing) -> float:
    """Largest net force on a grain over the largest contact force (Desrues eq. 19)."""
    net = np.zeros((packing.size, packing.dim))
    i, j = contacts.pairs.T
    np.add.at(net, i, contacts.forces)
    np.subtract.at(net, j, contacts.forces)
    largest = np.linalg.norm(contacts.forces, axis=1).max(initial=0.0)
    return float(np.linalg.norm(net, axis=1).max() / largest) if largest > 0 else 0.0


def _held_by(
    packing: Packing, values: np.ndarray | None, i: np.ndarray, j: np.ndarray
) -> np.ndarray | None:
    """What the packing holds for the pairs (i, j), zero where it holds nothing."""
    if values is None:
        return None
    known = packing.contacts[:, 0].astype(np.int64) * packing.size + packing.contacts[:, 1]
    order = np.argsort(known)
    wanted = i * packing.size + j
    place = np.searchsorted(known[order], wanted)
    place[place == len(known)] = 0
    held = np.zeros((len(i), *values.shape[1:]))
    if len(known):
        found = known[order][place] == wanted
        held[found] = values[order][place][found]
    return held


def tangential_vectors(normals: np.ndarray, tangential: np.ndarray) -> np.ndarray:
    """Tangential forces (C, d) from what a packing holds: along (-n_y, n_x) (C,), or (C, 3)."""
    if tangential.ndim == 2:
        return tangential
    return tangential[:, None] * np.column_stack([-normals[:, 1], normals[:, 0]])


def stress(packing: Packing, contacts: Contacts | None = None) -> np.ndarray:
    """Cauchy stress (d, d), Pa, tension positive: sum of f (x) b over V (Desrues eq. 27)."""
    contacts = contacts or touching(packing)
    return _sum_of_products(contacts.forces, contacts.branches) / packing.volume


def coordination_number(packing: Packing, contacts: Contacts | None = None) -> float:
    """Mean number of contacts of a grain, 2 C / N."""
    contacts = contacts or touching(packing)
    return 2.0 * len(contacts.pairs) / packing.size


def fabric(contacts: Contacts) -> np.ndarray:
    """phi (d, d): mean of n (x) n over the contacts (Guo-Zhao eq. 22); I / d without contacts."""
    dim = contacts.normals.shape[1]
    if len(contacts.normals) == 0:
        return np.eye(dim) / dim
    return _sum_of_products(contacts.normals, contacts.normals) / len(contacts.normals)


def _sum_of_products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sum of a (x) b over vectors (C, d), in their order; (d, d)."""
    return (a[:, :, None] * b[:, None, :]).sum(0)


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
    """Energy stored in the contacts, J, without cohesion.

    The integral of f_n over the overlap, f_t^2 / (2 k_t), and of rolling moments M^2 / (2 k_r).
    """
    contacts = contacts or touching(packing)
    # with u = s^2 a force that is a polynomial of the root of u is integrated exactly
    places, weights = np.polynomial.legendre.leggauss(8)
    law, overlaps, energy = packing.law.elasticity, np.abs(contacts.overlaps), 0.0
    for share, weight in zip(0.5 + 0.5 * places, weights, strict=True):
        forces, _, _ = elastic_response(law, contacts.coefficients, share**2 * overlaps)
        energy += weight * share * (forces * overlaps).sum()
    k_t = contacts.tangential_stiffness
    squared = tangential_vectors(contacts.normals, contacts.tangential) ** 2
    sheared = squared.any(1)
    energy += 0.5 * (squared.sum(1)[sheared] / k_t[sheared]).sum()
    if contacts.rolling is not None:
        radii = packing.radii[contacts.pairs]
        radius = radii.prod(1) / radii.sum(1)
        k_r = packing.law.rolling.rolling_stiffness(k_t, radius)
        squared = contacts.rolling.reshape(len(k_t), -1) ** 2
        rolled = squared.any(1)
        energy += 0.5 * (squared.sum(1)[rolled] / k_r[rolled]).sum()
    return float(energy)


@kernel
def measure(motion, pairs, law, cohesion, bonds, thickness, stress, fabric):
    """Stress and fabric (d, d) of a packing in the work space; returns (contacts, overlap).

    The same sums as `stress` and `fabric`, from the positions of this moment. `overlap` is the
    largest, as a share of the mean diameter of its two grains.
    """
    box, position = motion.box, motion.position
    dim = box.shape[0]
    branch, force = np.zeros(3), np.zeros(3)
    stress[:] = 0.0
    fabric[:] = 0.0
    contacts, largest = 0, 0.0
    last = pairs.memory.shape[0] - 1
    bond = None if bonds is None else 0.0
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
        length = math.sqrt(squared)
        overlap = pairs.reach[c] - length
        if bonds is not None:
            bond = pairs.memory[last, c]
        strained = strained_overlap(bonds, bond, overlap)
        if strained == 0.0:
            continue
        normal = elastic_force(law, bonds, pairs.coefficient[c], strained)
        if cohesion is not None:
            normal -= attraction(cohesion, overlap)
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
        largest = max(largest, overlap / pairs.reach[c])
    stress /= determinant(box) * thickness
    if contacts > 0:
        fabric /= contacts
    else:
        for a in range(dim):
            fabric[a, a] = 1.0 / dim
    return contacts, largest
