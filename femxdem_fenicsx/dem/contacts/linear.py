"""Linear elastic contacts (Desrues eq. 22, Guo-Zhao eq. 14-16)."""

from dataclasses import dataclass
from typing import NamedTuple

from .law import ContactLaw, must_be_at_least_zero, must_be_positive


class Linear(NamedTuple):
    """k_n is constant, k_n d the force; see `LinearContact`."""

    constant: float  # part of k_n that is the same for all pairs, N/m
    modulus: float  # E_c, Pa
    stiffness_ratio: float  # k_t / k_n

    stiffens = False

    def coefficient(law, radius_i, radius_j):
        """k_n, N/m (Guo-Zhao eq. 14)."""
        return law.constant + law.modulus * 2.0 * radius_i * radius_j / (radius_i + radius_j)

    def normal_force(law, coefficient, overlap):
        """k_n d, N (Desrues eq. 22, Guo-Zhao eq. 16)."""
        return coefficient * overlap

    def stiffnesses(law, coefficient, overlap):
        """(k_n, k_t), N/m (Guo-Zhao eq. 15)."""
        return coefficient, law.stiffness_ratio * coefficient


@dataclass(frozen=True, kw_only=True)
class LinearContact(ContactLaw):
    """Linear elastic contacts with Coulomb friction (Desrues eq. 22-26, Guo-Zhao eq. 14-17).

    Give exactly one of `stiffness` and `modulus`; all values must be finite, or ValueError.

    Attributes, beside those of `ContactLaw`:
        stiffness: k_n, the same for all contacts, N/m (Desrues).
        modulus: E_c, Pa: k_n = E_c r* with r* = 2 R_i R_j / (R_i + R_j) (Guo-Zhao eq. 14).
        stiffness_ratio: k_t / k_n (Guo-Zhao eq. 15).
    """

    stiffness: float | None = None
    modulus: float | None = None
    stiffness_ratio: float = 0.8

    def __post_init__(self):
        if (self.stiffness is None) == (self.modulus is None):
            raise ValueError("LinearContact: give either stiffness (N/m) or modulus (Pa), not both")
        must_be_positive(self, "stiffness" if self.modulus is None else "modulus")
        must_be_at_least_zero(self, "stiffness_ratio")
        super().__post_init__()

    @property
    def elasticity(self) -> Linear:
        """What the kernels take."""
        return Linear(
            float(self.stiffness or 0.0), float(self.modulus or 0.0), float(self.stiffness_ratio)
        )
