"""The contacts of one packing as the operators see them: branches, forces, stiffnesses.

A contact's force on its grain j is f = f_n n + T, n from i to j, T normal to n. Its stiffnesses are
k_n = df_n / du_n and k_t = df_t / du_t of the contact law (Guo-Zhao eq. 9), the linear law's here.
"""

from typing import NamedTuple

import numpy as np

from .. import dynamics, neighbours
from ..aliasing import kernel
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
            *np.empty((4, room)), np.empty((room, dim)), 0.0,
        )  # fmt: skip
        count = _fill(b, state, material, material.cohesion, work, *arrays[:-1])
        if count < 0:
            return dynamics.NO_ROOM
        volume = float(np.linalg.det(state[0][b])) * response.loading.thickness
        found.append(Network(*(array[:count] for array in arrays[:-1]), volume))
        return dynamics.OK

    response.with_workspace(fill, f"packing {b}")
    return found[-1]


@kernel
def stiffnesses(c, material, pairs):
    """(k_n, k_t) of a contact, N/m."""
    normal = pairs.stiffness[c]
    return normal, 0.0 if material.friction is None else material.stiffness_ratio * normal


@kernel
def _fill(
    b, state, material, cohesion, work, i, j, branch, reach, k_n, k_t, f_n, tangential
):  # fmt: skip
    """Write the contacts of packing b; returns their number, -1 where there is no room."""
    motion, history, pairs = work.motion, work.history, work.pairs
    motion.box[:] = state[0][b]
    motion.position[:] = state[1][b]
    history.first[:] = state[5][b]
    known = history.first[-1]
    history.j[:known] = state[6][b, :known]
    history.tangential[:, :known] = state[7][b, :, :known]
    box, position = motion.box, motion.position
    listed = neighbours.build(
        box, position, material.radius, material.inverse_mass, material.stiffness,
        material.modulus, material.viscosity, 0.0, pairs, work.grid,
    )  # fmt: skip
    if listed < 0:
        return -1
    neighbours.recall(pairs, history, work.grid)
    dim = box.shape[0]
    for c in range(listed):
        i[c], j[c], reach[c] = pairs.i[c], pairs.j[c], pairs.reach[c]
        squared = 0.0
        for p in range(dim):
            branch[c, p] = 0.0
            for q in range(dim):
                branch[c, p] += box[p, q] * (
                    position[q, j[c]] - position[q, i[c]] + pairs.shift[q, c]
                )
            squared += branch[c, p] ** 2
        length = np.sqrt(squared)
        k_n[c], k_t[c] = stiffnesses(c, material, pairs)
        f_n[c] = k_n[c] * (reach[c] - length)
        if cohesion is not None:
            f_n[c] -= cohesion
        if dim == 2:
            tangential[c, 0] = -pairs.tangential[0, c] * branch[c, 1] / length
            tangential[c, 1] = pairs.tangential[0, c] * branch[c, 0] / length
        else:
            for p in range(dim):
                tangential[c, p] = pairs.tangential[p, c]
    return listed


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
