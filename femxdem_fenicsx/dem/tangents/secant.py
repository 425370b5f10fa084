"""PSTLO-secant: PSTLO, softened by what sliding took from the stress in the step so far (ours)."""

import numpy as np

from ..response import Response
from .cto import LEAST_PERTURBATION
from .pstlo import prestressed_truss

#: Of the elastic stiffness along the step: no less is left, and no more is added, than these.
SOFTEST, STIFFEST = 0.3, 1.5
#: Strain after which PSTLO is computed anew.
RENEWED_AFTER = 5e-3


class Secant:
    """C + R (x) (C : E) / (E : C : E), C = PSTLO and E the strain of the step so far.

    R = dsigma - C : E is what sliding, opening and closing contacts took from the elastic change of
    the stress, known from the evaluation at F itself. Along the step this is the secant, dsigma;
    what is normal to it in the metric of C stays elastic, as in a law with one plastic mechanism
    whose flow is known. Points that strain by less than a CTO would perturb them keep PSTLO: their
    R is what the hold leaves unbalanced.

    PSTLO changes slowly: each packing keeps its own until it has strained by `RENEWED_AFTER`.

    Attributes:
        memory: `elastic` (B, d, d, d, d), Pa; `box` (B, d, d), m: the boxes for which it was
            computed, zero where it was not.
    """

    def __init__(self):
        self.memory: dict[str, np.ndarray] = {}

    def start(self, size: int, dim: int) -> None:
        """Remember nothing of that many packings."""
        self.memory["elastic"] = np.zeros((size, *[dim] * 4))
        self.memory["box"] = np.zeros((size, dim, dim))

    def __call__(self, response: Response, F: np.ndarray) -> np.ndarray:
        """C (B, d, d, d, d), Pa, at the last trial F (B, d, d)."""
        if not self.memory:
            self.start(response.size, F.shape[-1])
        elastic, box = self.memory["elastic"], self.memory["box"]
        now = response.latest.box
        strained = np.linalg.norm(box @ np.linalg.inv(now) - np.eye(F.shape[-1]), axis=(1, 2))
        old = np.flatnonzero(strained > RENEWED_AFTER)
        elastic[old], box[old] = prestressed_truss(response, F, old), now[old]
        change = response.outcome.stress - response.committed_outcome.stress
        return elastic + correction(elastic, F - np.eye(F.shape[-1]), change)


def correction(C: np.ndarray, motion: np.ndarray, change: np.ndarray) -> np.ndarray:
    """R (x) (C : E) / (E : C : E), (n, d, d, d, d), Pa.

    Args:
        C: elastic tangents (n, d, d, d, d), Pa.
        motion: F - I (n, d, d). change: of the stress with it (n, d, d), Pa.
    """
    E = 0.5 * (motion + np.swapaxes(motion, 1, 2))
    R = change - np.einsum("nijkl,nkl->nij", C, motion)
    CE = np.einsum("nijkl,nij->nkl", C, E)
    elastic, lost = (CE * E).sum((1, 2)), (R * E).sum((1, 2))
    known = (np.linalg.norm(E, axis=(1, 2)) > LEAST_PERTURBATION) & (elastic > 0) & (lost != 0)
    elastic, lost = np.where(known, elastic, 1.0), np.where(known, lost, 1.0)
    share = lost / elastic
    bounded = np.clip(share, SOFTEST - 1.0, STIFFEST - 1.0) / share
    weight = np.where(known, bounded / elastic, 0.0)
    return np.einsum("n,nij,nkl->nijkl", weight, R, CE)
