"""Kruyt's operators: all grains follow the strain of the packing, nobody asks for equilibrium.

One sum over the contacts serves UKO, UCKO, UCKO-2DOF and KAO.
"""

import numpy as np

from ..aliasing import kernel
from ..response import Response
from .network import network


def affine(
    response: Response, normal=1.0, tangential=1.0, turning: bool = False, forces: bool = False
) -> np.ndarray:
    """C (B, d, d, d, d), Pa, of the sum over the contacts in each packing's latest state.

    Args:
        response: the packings.
        normal, tangential: factors of k_n and k_t, numbers or (B,).
        turning: the grains turn with the packing, as in KAO; in UKO they do not turn at all.
        forces: the forces that the contacts bear turn with them, and the volume changes.
    """
    B, dim = response.size, response.latest.template.dim
    C = np.zeros((B, dim, dim, dim, dim))
    c_n, c_t = np.broadcast_to(normal, B), np.broadcast_to(tangential, B)

    def one(b: int) -> None:
        contacts = network(response, b)
        _affine(
            contacts.branch, c_n[b] * contacts.normal_stiffness,
            c_t[b] * contacts.tangential_stiffness, turning, C[b],
        )  # fmt: skip
        if forces:
            _turn_forces(contacts.branch, contacts.normal_force, contacts.tangential_force, C[b])
        C[b] /= contacts.volume
        if forces:
            identity, stress = np.eye(dim), contacts.stress
            C[b] += np.einsum("il,jk->ijkl", stress, identity)
            C[b] -= np.einsum("ij,kl->ijkl", stress, identity)

    response.for_each(one, np.arange(B))
    return C


@kernel
def _affine(branch, k_n, k_t, turning, C):
    """C += sum (k_n e e e e + k_t (t e) (t e)) l^2, or (t e + e t) / 2 for the second (t e).

    In 3D t t stands for both tangents, I - e e (Desrues eq. 33).
    """
    dim = branch.shape[1]
    e = np.empty(dim)
    for c in range(len(branch)):
        squared = 0.0
        for p in range(dim):
            squared += branch[c, p] ** 2
        for p in range(dim):
            e[p] = branch[c, p] / np.sqrt(squared)
        normal, tangential = k_n[c] * squared, k_t[c] * squared
        for i in range(dim):
            for j in range(dim):
                for k in range(dim):
                    for m in range(dim):
                        along = e[i] * e[j] * e[k] * e[m]
                        across = (e[j] * e[m] if i == k else 0.0) - along
                        if turning:
                            swapped = (e[j] * e[k] if i == m else 0.0) - along
                            across = 0.5 * (across + swapped)
                        C[i, j, k, m] += normal * along + tangential * across


@kernel
def _turn_forces(branch, f_n, tangential, C):
    """C += sum of l (f_n t - f_t e) e (t e), of the forces on the grains i (Argilaga eq. C.2).

    In 3D the tangential force turns about the normal too, with the packing's spin.
    """
    dim = branch.shape[1]
    e = np.empty(dim)
    for c in range(len(branch)):
        squared = 0.0
        for p in range(dim):
            squared += branch[c, p] ** 2
        length = np.sqrt(squared)
        for p in range(dim):
            e[p] = branch[c, p] / length
        for i in range(dim):
            for j in range(dim):
                for k in range(dim):
                    across = f_n[c] * ((1.0 if i == k else 0.0) - e[i] * e[k])
                    turned = across - e[i] * tangential[c, k]
                    for m in range(dim):
                        twisted = tangential[c, m] * ((1.0 if i == k else 0.0) - e[i] * e[k])
                        twisted -= tangential[c, k] * ((1.0 if i == m else 0.0) - e[i] * e[m])
                        C[i, j, k, m] -= length * (turned * e[m] + 0.5 * twisted) * e[j]
