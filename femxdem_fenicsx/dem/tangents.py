"""Tangent operators C = d sigma / d F of a batch of packings (Argilaga sections 3-5).

An operator takes the response and the last trial F (B, 2, 2) and returns C (B, 2, 2, 2, 2), Pa,
the derivative of the stress by F's last motion, d sigma = C : (dF F^-1); see `OPERATORS`.
"""

from collections.abc import Callable

import numpy as np

from . import dynamics, neighbours
from .aliasing import kernel
from .response import Response

#: Least size of the strain that a CTO is perturbed by; the step's own strain above it.
LEAST_PERTURBATION = 1e-5


def upper_bound_kruyt(response: Response, F: np.ndarray) -> np.ndarray:
    """UKO: all grains follow the strain, contacts are elastic (Argilaga eq. 13, Guo-Zhao eq. 9).

    C = 1/V sum l^2 (k_n e e e e + k_t t e t e) over the contacts of the latest state.
    """
    C = np.zeros((response.size, 2, 2, 2, 2))

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
    e, t = np.empty(2), np.empty(2)
    for k in range(count):
        i, j = pairs.i[k], pairs.j[k]
        sx = position[0, j] - position[0, i] + pairs.shift[0, k]
        sy = position[1, j] - position[1, i] + pairs.shift[1, k]
        e[0], e[1] = box[0, 0] * sx + box[0, 1] * sy, box[1, 0] * sx + box[1, 1] * sy
        t[0], t[1] = -e[1], e[0]
        squared = e[0] ** 2 + e[1] ** 2
        kn = pairs.stiffness[k] / squared
        kt = 0.0 if material.friction is None else material.stiffness_ratio * kn
        for p in range(2):
            for q in range(2):
                for r in range(2):
                    for s in range(2):
                        c[p, q, r, s] += (kn * e[p] * e[r] + kt * t[p] * t[r]) * e[q] * e[s]
    c /= box[0, 0] * box[1, 1] - box[0, 1] * box[1, 0]
    return dynamics.OK


def consistent_tangent(response: Response, F: np.ndarray) -> np.ndarray:
    """CTO: four perturbed evaluations of the whole increment (Argilaga eq. 6, Guo-Zhao eq. 8).

    The perturbation is the step's own strain at each point, so that contacts slide in it as they
    do in the step; an infinitesimal one sees an elastic packing.
    """
    B = response.size
    size = np.maximum(np.linalg.norm(F - np.eye(2), axis=(1, 2)), LEAST_PERTURBATION)
    packings = np.repeat(np.arange(B), 4)
    directions = np.eye(4).reshape(4, 2, 2)
    motion = np.eye(2) + size[:, None, None, None] * directions
    base = response.outcome.stress
    perturbed = response.probe((motion @ F[:, None]).reshape(-1, 2, 2), packings)
    change = perturbed.stress.reshape(B, 4, 2, 2) - base[:, None]
    C = change / size[:, None, None, None]
    return np.moveaxis(C, 1, -1).reshape(B, 2, 2, 2, 2)


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
