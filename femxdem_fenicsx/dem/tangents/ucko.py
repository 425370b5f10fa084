"""UCKO and UCKO-2DOF, corrected Kruyt operators (Argilaga eq. 16 and 17)."""

import numpy as np

from ..response import Response
from .cto import consistent_tangent
from .kruyt import affine

#: Least strain of a step at whose CTO the operators are calibrated.
LEAST_STRAIN = 1e-4


class _Calibrated:
    """Kruyt's sum with factors of k_n and k_t (B, 2), found once from a CTO at the beginning.

    Until there is a step with a strain, UKO.

    Attributes:
        memory: `factors` (B, 2).
    """

    def __init__(self):
        self.memory: dict[str, np.ndarray] = {}

    def start(self, size: int, dim: int) -> None:
        """Remember nothing of that many packings."""
        self.memory["factors"] = np.zeros((size, 2))

    def __call__(self, response: Response, F: np.ndarray) -> np.ndarray:
        if not self.memory:
            self.start(response.size, F.shape[-1])
        factors = self.memory["factors"]
        strain = np.linalg.norm(F - np.eye(F.shape[-1]), axis=(1, 2))
        new = ~factors.any(1) & (strain >= LEAST_STRAIN)
        if new.any():
            by_parts = [affine(response, 1.0, 0.0)[new], affine(response, 0.0, 1.0)[new]]
            factors[new] = self.calibrate(consistent_tangent(response, F)[new], *by_parts)
        now = np.where(factors.any(1)[:, None], factors, 1.0)
        return affine(response, now[:, 0], now[:, 1])

    def calibrate(self, C: np.ndarray, normal: np.ndarray, tangential: np.ndarray) -> np.ndarray:
        """Factors (B, 2) that bring the parts of UKO close to C."""
        raise NotImplementedError


def _normal_terms(C: np.ndarray) -> np.ndarray:
    """Mean of C_1111, C_2222, ... (B,)."""
    return np.einsum("niiii->n", C) / C.shape[1]


def _coupling_terms(C: np.ndarray) -> np.ndarray:
    """Mean of C_1122, C_2211, ... (B,)."""
    dim = C.shape[1]
    return (np.einsum("niikk->n", C) - np.einsum("niiii->n", C)) / (dim * (dim - 1))


class UpperBoundCorrected(_Calibrated):
    """UCKO: C = c_x C_UKO (eq. 16), with the CTO's mean of C_1111 and C_2222."""

    def calibrate(self, C, normal, tangential):
        factor = _normal_terms(C) / _normal_terms(normal + tangential)
        return np.column_stack([factor, factor])


class UpperBoundCorrected2(_Calibrated):
    """UCKO-2DOF: c_n k_n and c_t k_t for k_n and k_t (eq. 17), from two terms of the CTO.

    The means of C_1111 and C_2222, and of C_1122 and C_2211, which are less noisy than one of each.
    """

    def calibrate(self, C, normal, tangential):
        parts = np.array(
            [[term(part) for part in (normal, tangential)] for term in (_normal_terms, _coupling_terms)]
        )  # fmt: skip
        wanted = np.array([_normal_terms(C), _coupling_terms(C)])
        return np.linalg.solve(parts.transpose(2, 0, 1), wanted.T[:, :, None])[..., 0]
