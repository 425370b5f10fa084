"""Hertz-Mindlin contacts: elastic spheres pressed together (Guo-Zhao section 2.2)."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from .law import ContactLaw, must_be_positive


class Hertz(NamedTuple):
    """The stiffness grows with the root of the overlap u; see `HertzMindlin`."""

    shear_modulus: float  # G, Pa
    poisson_ratio: float  # nu

    def coefficient(law, radius_i, radius_j):
        """G / (1 - nu) sqrt(2 r*), N / m^1.5, with r* = 2 R_i R_j / (R_i + R_j)."""
        common_radius = 2.0 * radius_i * radius_j / (radius_i + radius_j)
        return law.shear_modulus / (1.0 - law.poisson_ratio) * math.sqrt(2.0 * common_radius)

    def normal_force(law, coefficient, overlap):
        """2/3 G / (1 - nu) sqrt(2 r*) u^1.5, N: the integral of k_n."""
        return 2.0 / 3.0 * coefficient * overlap * math.sqrt(overlap)

    def stiffnesses(law, coefficient, overlap):
        """(G / (1 - nu) sqrt(2 r* u), 2 G / (2 - nu) sqrt(2 r* u)), N/m (Guo-Zhao section 2.2)."""
        k_n = coefficient * math.sqrt(overlap)
        return k_n, 2.0 * (1.0 - law.poisson_ratio) / (2.0 - law.poisson_ratio) * k_n


@dataclass(frozen=True, kw_only=True)
class HertzMindlin(ContactLaw):
    """Contacts of elastic spheres with Coulomb friction (Guo-Zhao section 2.2).

    Disks touch as spheres of their radii do, whatever their thickness. The tangential spring is
    Mindlin's without slip, k_t(u); see `kept_share` of `interface` for what happens as u changes.

    Attributes, beside those of `ContactLaw`:
        shear_modulus: G of the grains' material, Pa.
        poisson_ratio: nu of it, in [0, 0.5].
    """

    shear_modulus: float
    poisson_ratio: float = 0.2

    def __post_init__(self):
        must_be_positive(self, "shear_modulus")
        if not 0 <= self.poisson_ratio <= 0.5:
            raise ValueError(
                f"HertzMindlin: poisson_ratio must be in [0, 0.5], got {self.poisson_ratio}"
            )
        super().__post_init__()

    @property
    def elasticity(self) -> Hertz:
        """What the kernels take."""
        return Hertz(float(self.shear_modulus), float(self.poisson_ratio))
