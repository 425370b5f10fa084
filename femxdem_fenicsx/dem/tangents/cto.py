"""CTO, the consistent tangent operator (Argilaga eq. 6, Guo-Zhao eq. 8, Desrues eq. 31)."""

import numpy as np

from ..response import Response
from .network import objective, strains

#: Least size of the strain that a CTO is perturbed by; the step's own strain above it. What a hold
#: leaves unbalanced is a few percent of the change of the stress there, and more of it below.
LEAST_PERTURBATION = 1e-4


def consistent_tangent(
    response: Response, F: np.ndarray, least: float = LEAST_PERTURBATION
) -> np.ndarray:
    """CTO: perturbed evaluations of the whole increment, one for each strain.

    The perturbation is the step's own strain at each point, so that contacts slide in it as they
    do in the step; an infinitesimal one sees an elastic packing. Rotations need none: they turn
    the stress. That leaves 3 evaluations in 2D and 6 in 3D, where eq. 6 has 4 and 9.
    """
    B, dim = response.size, F.shape[-1]
    identity, basis = np.eye(dim), strains(F.shape[-1])
    size = np.maximum(np.linalg.norm(F - identity, axis=(1, 2)), least)
    motion = identity + size[:, None, None, None] * basis
    packings = np.repeat(np.arange(B), len(basis))
    base = response.outcome.stress
    perturbed = response.probe((motion @ F[:, None]).reshape(-1, dim, dim), packings).stress
    change = perturbed.reshape(B, -1, dim, dim) - base[:, None]
    return objective(change / size[:, None, None, None], base)
