"""Contact laws: what two grains that overlap do to each other, and with which parameters."""

from dataclasses import dataclass
from math import isfinite

from .aliasing import kernel

#: Schemes of the tangential force: Desrues eq. 24 (the variant used there), eq. 10, eq. 12.
SCHEMES = ("semi-explicit", "projection", "implicit")


@dataclass(frozen=True)
class LinearContact:
    """Linear elastic contacts with Coulomb friction (Desrues eq. 22-26, Guo-Zhao eq. 14-17).

    Give exactly one of `stiffness` and `modulus`; all values must be finite, or ValueError.

    Attributes:
        stiffness: k_n, the same for all contacts, N/m (Desrues).
        modulus: E_c, Pa: k_n = E_c r* with r* = 2 R_i R_j / (R_i + R_j) (Guo-Zhao eq. 14).
        stiffness_ratio: k_t / k_n (Guo-Zhao eq. 15).
        friction: Coulomb coefficient mu = tan(phi); 0 switches tangential forces off.
        cohesion: f_c, constant attraction of touching grains, N. The force is k_n d - f_c, and
            friction is limited by the elastic part, mu k_n d.
        viscous_damping: eta in [0, 1[, share of the critical damping of a contact (eq. 22, with
            the reduced mass M_n M_m / (M_n + M_m); the paper prints its inverse).
        scheme: how the tangential force of spheres turns with its contact from step to step, one of
            `SCHEMES`; disks need none.
    """

    stiffness: float | None = None
    modulus: float | None = None
    stiffness_ratio: float = 0.8
    friction: float = 0.5
    cohesion: float = 0.0
    viscous_damping: float = 0.0
    scheme: str = "semi-explicit"

    def __post_init__(self):
        if (self.stiffness is None) == (self.modulus is None):
            raise ValueError("LinearContact: give either stiffness (N/m) or modulus (Pa), not both")
        scale = self.stiffness if self.modulus is None else self.modulus
        if not (isfinite(scale) and scale > 0):
            raise ValueError(f"LinearContact: stiffness or modulus must be positive, got {scale}")
        for name in ("stiffness_ratio", "friction", "cohesion"):
            value = getattr(self, name)
            if not (isfinite(value) and value >= 0):
                raise ValueError(f"LinearContact: {name} must be zero or positive, got {value}")
        if not 0 <= self.viscous_damping < 1:
            raise ValueError(
                f"LinearContact: viscous_damping must be in [0, 1[, got {self.viscous_damping}"
            )

        if self.scheme not in SCHEMES:
            raise ValueError(
                f"LinearContact: unknown scheme '{self.scheme}'; choose from {', '.join(SCHEMES)}"
            )

    @property
    def stiffnesses(self) -> tuple[float, float]:
        """(constant part of k_n in N/m, modulus in Pa); one of the two is zero."""
        return float(self.stiffness or 0.0), float(self.modulus or 0.0)

    @property
    def features(self) -> tuple[float | None, float | None, float | None]:
        """(friction, cohesion, viscous damping), None for what the scene does not have.

        The type None makes Numba compile a kernel that holds no trace of that feature.
        """
        return self.friction or None, self.cohesion or None, self.viscous_damping or None

    @property
    def turning(self) -> tuple[bool | None, bool | None]:
        """(projected, implicit): True for the scheme in use, None for others."""
        return self.scheme == "projection" or None, self.scheme == "implicit" or None


@kernel
def normal_stiffness(radius_i, radius_j, constant, modulus):
    """k_n of a pair, N/m (Guo-Zhao eq. 14 where it comes from a modulus)."""
    return constant + modulus * 2.0 * radius_i * radius_j / (radius_i + radius_j)
