"""Tangent operators C = d sigma / d F of a batch of packings (Argilaga sections 3-5).

An operator takes the response and the last trial F (B, d, d) and returns C (B, d, d, d, d), Pa,
the derivative of the stress by F's last motion, d sigma = C : (dF F^-1); see `OPERATORS`.
"""

import math
from collections.abc import Callable

import numpy as np

from . import dynamics
from .aliasing import kernel
from .contacts.interface import stiffnesses, strained_overlap
from .loading import restore
from .response import Response
from .small import determinant

#: Least size of the strain that a CTO is perturbed by; the step's own strain above it.
LEAST_PERTURBATION = 1e-5


def upper_bound_kruyt(response: Response, F: np.ndarray) -> np.ndarray:
    """UKO: all grains follow the strain, contacts are elastic (Argilaga eq. 13, Guo-Zhao eq. 9).

    C = 1/V sum l^2 (k_n e e e e + k_t t e t e) over the contacts of the latest state; in 3D with
    both tangents, that is k_t (I - e e) for t t (Desrues eq. 33).
    """
    dim = F.shape[-1]
    C = np.zeros((response.size, dim, dim, dim, dim))

    def one(b: int) -> None:
        response.with_workspace(
            lambda work: _uko(b, response.latest.state, response.material, work, C), f"packing {b}"
        )

    response.for_each(one, np.arange(response.size))
    return C / response.loading.thickness


@kernel
def _uko(b, state, material, work, C):
    return _uko_with(b, state, material, work, C, material.bonds)


@kernel
def _uko_with(b, state, material, work, C, bonds):
    restore(b, state, work)
    if dynamics.start(material, work) != dynamics.OK:
        return dynamics.NO_ROOM
    box, position, pairs = work.motion.box, work.motion.position, work.pairs
    c = C[b]
    dim = box.shape[0]
    e = np.empty(dim)
    bond = None if bonds is None else 0.0
    for k in range(pairs.first[-1]):
        i, j = pairs.i[k], pairs.j[k]
        squared = 0.0
        for p in range(dim):
            e[p] = 0.0
            for q in range(dim):
                e[p] += box[p, q] * (position[q, j] - position[q, i] + pairs.shift[q, k])
            squared += e[p] ** 2
        if bonds is not None:
            bond = pairs.memory[-1, k]
        strained = strained_overlap(bonds, bond, pairs.reach[k] - math.sqrt(squared))
        if strained == 0.0:
            continue
        kn, kt = stiffnesses(material.law, pairs.coefficient[k], abs(strained))
        if material.friction is None:
            kt = 0.0
        for p in range(dim):
            for r in range(dim):
                directed = (kn - kt) * e[p] * e[r] / squared + (kt if p == r else 0.0)
                for q in range(dim):
                    for s in range(dim):
                        c[p, q, r, s] += directed * e[q] * e[s]
    c /= determinant(box)
    return dynamics.OK


def consistent_tangent(response: Response, F: np.ndarray) -> np.ndarray:
    """CTO: d^2 perturbed evaluations of the whole increment (Argilaga eq. 6, Guo-Zhao eq. 8).

    The perturbation is the step's own strain at each point, so that contacts slide in it as they
    do in the step; an infinitesimal one sees an elastic packing.
    """
    B, d = response.size, F.shape[-1]
    size = np.maximum(np.linalg.norm(F - np.eye(d), axis=(1, 2)), LEAST_PERTURBATION)
    packings = np.repeat(np.arange(B), d * d)
    directions = np.eye(d * d).reshape(d * d, d, d)
    motion = np.eye(d) + size[:, None, None, None] * directions
    base = response.outcome.stress
    perturbed = response.probe((motion @ F[:, None]).reshape(-1, d, d), packings)
    change = perturbed.stress.reshape(B, d * d, d, d) - base[:, None]
    C = change / size[:, None, None, None]
    return np.moveaxis(C, 1, -1).reshape(B, d, d, d, d)


#: Tangent operators by name: the registry that `--operator` chooses from.
OPERATORS: dict[str, Callable[[Response, np.ndarray], np.ndarray]] = {
    "UKO": upper_bound_kruyt,
    "CTO": consistent_tangent,
}


def operator(name: str) -> Callable[[Response, np.ndarray], np.ndarray]:
    """The operator of that name; ValueError with the known names otherwise."""
    if name not in OPERATORS:
        raise ValueError(f"unknown operator '{name}'; choose from {', '.join(OPERATORS)}")
    return OPERATORS[name]
