"""AEO, the auxiliary elastic operator (Argilaga section 3.2, Desrues section 2.5.2)."""

import numpy as np

from ..response import Response
from .cto import consistent_tangent

#: Steps at the beginning whose CTO is averaged.
STEPS = 5


class AuxiliaryElastic:
    """AEO: the CTO in the first steps; from then on, point by point, the mean of those steps'.

    Of each step the last CTO counts, that is the one nearest to its converged end.

    Attributes:
        memory: `tangents` (B, STEPS, d, d, d, d), Pa; `seen` (B,): how many of them are there.
    """

    def __init__(self):
        self.memory: dict[str, np.ndarray] = {}
        self._step = -1

    def start(self, size: int, dim: int) -> None:
        """Remember nothing of that many packings."""
        self.memory["tangents"] = np.zeros((size, STEPS, *[dim] * 4))
        self.memory["seen"] = np.zeros(size, np.int64)

    def __call__(self, response: Response, F: np.ndarray) -> np.ndarray:
        if not self.memory:
            self.start(response.size, F.shape[-1])
        tangents, seen = self.memory["tangents"], self.memory["seen"]
        new_step = response.commits != self._step
        if (seen == STEPS).all() and new_step:
            return tangents.mean(1)
        seen += new_step
        self._step = response.commits
        C = consistent_tangent(response, F)
        tangents[range(len(seen)), seen - 1] = C
        return C
