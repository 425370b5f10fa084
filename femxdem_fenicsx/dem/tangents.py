"""Tangent operators C = d sigma / d F of a batch of packings (Argilaga sections 3-5).

An operator takes the response and the last trial F (B, d, d) and returns C (B, d, d, d, d), Pa,
the derivative of the stress by F's last motion, d sigma = C : (dF F^-1); see `OPERATORS`.
"""

from collections.abc import Callable

import numpy as np

from . import dynamics, neighbours
from .aliasing import kernel
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
    work.motion.box[:] = state[0][b]
    work.motion.position[:] = state[1][b]
    box, position, pairs = work.motion.box, work.motion.position, work.pairs
    count = neighbours.build(
        box, position, material.radius, material.inverse_mass, material.stiffness,
        material.modulus, material.viscosity, 0.0, pairs, work.grid,
    )  # fmt: skip
    if count < 0:
        return dynamics.NO_ROOM
    c = C[b]
    dim = box.shape[0]
    e = np.empty(dim)
    for k in range(count):
        i, j = pairs.i[k], pairs.j[k]
        squared = 0.0
        for p in range(dim):
            e[p] = 0.0
            for q in range(dim):
                e[p] += box[p, q] * (position[q, j] - position[q, i] + pairs.shift[q, k])
            squared += e[p] ** 2
        kn = pairs.stiffness[k]
        kt = 0.0 if material.friction is None else material.stiffness_ratio * kn
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
