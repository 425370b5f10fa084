"""Hill-Mandel: the work done on a packing is what it stores, moves with, rubs away and is damped.

The ledger is kept here, outside the kernels, from positions, velocities and forces alone.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from femxdem_fenicsx.dem.homogenisation import elastic_energy
from femxdem_fenicsx.dem.preparation import random_packing
from femxdem_fenicsx.dem.stability import stable_time_step
from tests.reference import reference_packing

from .scenes import Moving

DAMPING = 0.3
SPINNING = {2: 0.5, 3: 0.4}  # inertia over m R^2


@dataclass
class Ledger:
    """Energies since the beginning, J; `least_rubbed` is the smallest of a contact in a step."""

    work: float = 0.0
    rubbed: float = 0.0
    damped: float = 0.0
    least_rubbed: float = 0.0


def in_space(vectors: np.ndarray) -> np.ndarray:
    """(n, d) -> (n, 3); spins in the plane (n, 1) point out of it."""
    if vectors.shape[1] == 1:
        return np.pad(vectors, [(0, 0), (2, 0)])
    return np.pad(vectors, [(0, 0), (0, 3 - vectors.shape[1])])


def tangential_of(work, normals: np.ndarray) -> np.ndarray:
    """Tangential force on j of every pair of the list, (P, 3), N."""
    held = work.pairs.tangential[:, : len(normals)].T
    if held.shape[1] == 3:
        return held.copy()
    return held * np.column_stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals))])


def contacts_of(work, position: np.ndarray, box: np.ndarray):
    """(i, j, branches (P, 3), lengths, normals) of the pairs of the list at these positions."""
    count = work.pairs.first[-1]
    i, j = work.pairs.i[:count].astype(int), work.pairs.j[:count].astype(int)
    reduced = position[:, j] - position[:, i] + work.pairs.shift[:, :count]
    branches = in_space((box @ reduced).T)
    lengths = np.linalg.norm(branches, axis=1)
    return i, j, branches, lengths, branches / lengths[:, None]


def kinetic_energy(moving: Moving) -> float:
    motion, masses = moving.work.motion, moving.packing.masses
    inertia = SPINNING[moving.packing.dim] * masses
    return 0.5 * float(
        (masses * motion.velocity**2).sum() + (inertia * motion.rim_velocity**2).sum()
    )


def one_step(moving: Moving, dt: float, L: np.ndarray, ledger: Ledger, held: np.ndarray) -> None:
    """Advance by dt (s) with the symmetric velocity gradient L (d, d), and keep the ledger.

    `held` (N, N, 3) lends its room for the tangential forces before the step: the pair list may
    be built anew in it.
    """
    work, dim, law = moving.work, moving.packing.dim, moving.packing.law
    motion = work.motion
    x, box = motion.position.copy(), motion.box.copy()
    v, w = motion.velocity.copy(), motion.rim_velocity.copy()
    i, j, _, _, normals = contacts_of(work, x, box)
    held[i, j] = tangential_of(work, normals)

    moving.advance(1, dt, L, DAMPING)

    i, j, branches, lengths, normals = contacts_of(work, x, box)
    count = len(i)
    forces = in_space(work.forces.pair[:, :count].T)
    affine = in_space((L @ branches[:, :dim].T).T)
    ledger.work -= dt * (forces * affine).sum()

    relative = in_space((v[:, j] - v[:, i]).T) + affine
    rims = (lengths / work.pairs.reach[:count])[:, None] * in_space((w[:, i] + w[:, j]).T)
    slip = relative - (relative * normals).sum(1)[:, None] * normals - np.cross(rims, normals)
    before, after = held[i, j], tangential_of(work, normals)
    kt = law.stiffness_ratio * work.pairs.coefficient[:count]
    stored = ((after**2).sum(1) - (before**2).sum(1)) / (2.0 * kt)
    rubbed = -0.5 * dt * ((before + after) * slip).sum(1) - stored
    ledger.rubbed += rubbed.sum()
    ledger.least_rubbed = min(ledger.least_rubbed, rubbed.min())

    spin = slice(2, 3) if dim == 2 else slice(4, 7)
    for force, old, new, inverse in (
        (work.forces.grain[:, :dim].T, v, motion.velocity, moving.material.inverse_mass),
        (work.forces.grain[:, spin].T, w, motion.rim_velocity,
         moving.material.inverse_mass / SPINNING[dim]),
    ):  # fmt: skip
        way = np.sign(old + 0.5 * dt * inverse * force)
        ledger.damped += dt * (DAMPING * np.abs(force) * way * 0.5 * (old + new)).sum()


@pytest.mark.parametrize("dim", [2, 3])
def test_the_work_of_shearing_is_stored_moving_rubbed_and_damped_energy(dim):
    packing = reference_packing() if dim == 2 else random_packing(300, dim=3)
    moving, ledger = Moving(packing), Ledger()
    held = np.zeros((packing.size, packing.size, 3))
    dt = 0.8 * stable_time_step(packing)
    L = np.diag([0.4, -0.5] if dim == 2 else [0.2, -0.5, 0.2])  # I is about 1e-3
    start = elastic_energy(packing)
    for _ in range(round(0.01 / 0.5 / dt)):
        one_step(moving, dt, L, ledger, held)
    stored = elastic_energy(moving.now) - start + kinetic_energy(moving)
    assert ledger.work > 0
    assert stored + ledger.rubbed + ledger.damped == pytest.approx(ledger.work, rel=1e-2)
    assert ledger.rubbed > 0.2 * ledger.work
    assert ledger.least_rubbed > -1e-6 * ledger.work  # friction only takes
