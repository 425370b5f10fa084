"""The contacts of one packing as the operators see them: branches, forces, stiffnesses.

A contact's force on its grain j is f = f_n n + T, n from i to j, T normal to n. Its stiffnesses are
k_n = df_n / du_n and k_t = df_t / du_t, those of its contact law (Guo-Zhao eq. 9).
"""

from typing import NamedTuple

import numpy as np

from .. import dynamics
from ..aliasing import kernel
from ..contacts.interface import (
    attraction,
    elastic_force,
    rolling_stiffness,
    stiffnesses,
    strained_overlap,
)
from ..loading import restore
from ..response import Response


class Network(NamedTuple):
    """C contacts of N grains in d dimensions."""

    i: np.ndarray  # (C,)
    j: np.ndarray  # (C,)
    branch: np.ndarray  # (C, d) from i to j, m
    reach: np.ndarray  # (C,) sum of radii, m
    normal_stiffness: np.ndarray  # (C,) N/m
    tangential_stiffness: np.ndarray  # (C,) N/m
    normal_force: np.ndarray  # (C,) compression positive, N
    tangential_force: np.ndarray  # (C, d) T on j, N
    rolling_stiffness: np.ndarray  # (C,) N m; 0 without rolling resistance
    volume: float  # of the box, m3

    @property
    def stress(self) -> np.ndarray:
        """Cauchy stress (d, d), Pa, tension positive (Argilaga eq. 8)."""
        normals = self.branch / np.linalg.norm(self.branch, axis=1)[:, None]
        on_j = self.normal_force[:, None] * normals + self.tangential_force
        return -on_j.T @ self.branch / self.volume


def network(response: Response, b: int) -> Network:
    """The contacts of packing b in its latest state."""
    state, material, found = response.latest.state, response.material, []

    def fill(work) -> int:
        room, dim = work.pairs.i.size, state[0].shape[1]
        arrays = Network(
            np.empty(room, np.int64), np.empty(room, np.int64), np.empty((room, dim)),
            *np.empty((4, room)), np.empty((room, dim)), np.zeros(room), 0.0,
        )  # fmt: skip
        restore(b, state, work.motion, work.history)
        status = dynamics.start(
            work, material.radius, material.inverse_mass, material.law, material.viscosity,
            material.skin,
        )  # fmt: skip
        if status != dynamics.OK:
            return status
        count = _fill(
            work.motion, work.pairs, material.radius, material.law, material.friction,
            material.cohesion, material.rolling, material.bonds, *arrays[:-1],
        )  # fmt: skip
        volume = float(np.linalg.det(state[0][b])) * response.loading.thickness
        found.append(Network(*(array[:count] for array in arrays[:-1]), volume))
        return dynamics.OK

    response.with_workspace(fill, f"packing {b}")
    return found[-1]


@kernel
def _fill(
    motion, pairs, radius, law, friction, cohesion, rolling, bonds,
    i, j, branch, reach, k_n, k_t, f_n, tangential, k_r,
):  # fmt: skip
    """Write the contacts of a packing in the work space; returns their number."""
    box, position = motion.box, motion.position
    dim, c = box.shape[0], 0
    bond = None if bonds is None else 0.0
    for pair in range(pairs.first[-1]):
        i[c], j[c], reach[c] = pairs.i[pair], pairs.j[pair], pairs.reach[pair]
        squared = 0.0
        for p in range(dim):
            branch[c, p] = 0.0
            for q in range(dim):
                branch[c, p] += box[p, q] * (
                    position[q, j[c]] - position[q, i[c]] + pairs.shift[q, pair]
                )
            squared += branch[c, p] ** 2
        length = np.sqrt(squared)
        if bonds is not None:
            bond = pairs.memory[-1, pair]
        strained = strained_overlap(bonds, bond, reach[c] - length)
        if strained == 0.0:
            continue
        k_n[c], k_t[c] = stiffnesses(law, pairs.coefficient[pair], abs(strained))
        f_n[c] = elastic_force(law, bonds, pairs.coefficient[pair], strained)
        if friction is None:
            k_t[c] = 0.0
        if cohesion is not None:
            f_n[c] -= attraction(cohesion, reach[c] - length)
        if rolling is not None:
            one, other = radius[i[c]], radius[j[c]]
            k_r[c] = rolling_stiffness(rolling, k_t[c], one * other / (one + other))
        if dim == 2:
            tangential[c, 0] = -pairs.tangential[0, pair] * branch[c, 1] / length
            tangential[c, 1] = pairs.tangential[0, pair] * branch[c, 0] / length
        else:
            for p in range(dim):
                tangential[c, p] = pairs.tangential[p, pair]
        c += 1
    return c


def objective(columns: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """C (..., d, d, d, d) from the answers to d (d + 1) / 2 strains (`strains`), Pa.

    A rotation of the whole packing turns its stress: dsigma = W sigma - sigma W for a skew W.

    Args:
        columns: (..., s, d, d) change of the stress (d, d) per unit of each of `strains(d)`.
        stress: (..., d, d).
    """
    dim = stress.shape[-1]
    identity = np.eye(dim)
    C = np.einsum("...sij,skl->...ijkl", columns, strains(dim))
    turned = np.einsum("ik,...lj->...ijkl", identity, stress) + np.einsum(
        "...il,jk->...ijkl", stress, identity
    )
    return C + 0.5 * (turned - np.swapaxes(turned, -1, -2))


def strains(dim: int) -> np.ndarray:
    """An orthonormal basis of the symmetric tensors, (d (d + 1) / 2, d, d)."""
    basis = []
    for k in range(dim):
        for m in range(k, dim):
            strain = np.zeros((dim, dim))
            strain[k, m] += 0.5
            strain[m, k] += 0.5
            basis.append(strain / np.linalg.norm(strain))
    return np.array(basis)
