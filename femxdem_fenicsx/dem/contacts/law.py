"""What all contact laws share: friction, cohesion, damping, rolling resistance, bonds."""

from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

from .bonds import Bonds
from .rolling import RollingResistance

#: Schemes of the tangential force: Desrues eq. 24 (the variant used there), eq. 10, eq. 12.
SCHEMES = ("semi-explicit", "projection", "implicit")


@dataclass(frozen=True, kw_only=True)
class ContactLaw:
    """An elastic law (a subclass, see docs/contact-laws.md) and what can be combined with it.

    Attributes; all values must be finite, or ValueError:
        friction: Coulomb coefficient mu = tan(phi); 0 switches tangential forces off.
        cohesion: f_c, constant attraction of touching grains, N. The force is that of the elastic
            law less f_c, and friction is limited by the elastic part.
        viscous_damping: eta in [0, 1[, share of the critical damping of a contact (eq. 22, with
            the reduced mass M_n M_m / (M_n + M_m); the paper prints its inverse).
        scheme: how the tangential force of spheres turns with its contact from step to step, one of
            `SCHEMES`; disks need none.
        rolling: resistance against rolling; it needs friction.
        bonds: strength of cemented contacts; they need friction. Which contacts are cemented is up
            to the packing.
    """

    friction: float = 0.5
    cohesion: float = 0.0
    viscous_damping: float = 0.0
    scheme: str = "semi-explicit"
    rolling: RollingResistance | None = None
    bonds: Bonds | None = None

    def __post_init__(self):
        name = type(self).__name__
        must_be_at_least_zero(self, "friction", "cohesion")
        if not 0 <= self.viscous_damping < 1:
            raise ValueError(
                f"{name}: viscous_damping must be in [0, 1[, got {self.viscous_damping}"
            )
        if self.scheme not in SCHEMES:
            raise ValueError(
                f"{name}: unknown scheme '{self.scheme}'; choose from {', '.join(SCHEMES)}"
            )
        for part, kind in (("rolling", RollingResistance), ("bonds", Bonds)):
            given = getattr(self, part)
            if given is None:
                continue
            given = kind(*given)
            for field, value in given._asdict().items():
                if not (isfinite(value) and value >= 0):
                    raise ValueError(
                        f"{name}: {part}.{field} must be zero or positive, got {value}"
                    )
            if not self.friction > 0:
                raise ValueError(f"{name}: {part} need friction; give friction > 0")
            object.__setattr__(self, part, kind(*map(float, given)))

    @property
    def elasticity(self) -> NamedTuple:
        """The elastic law as the kernels take it."""
        raise NotImplementedError(f"{type(self).__name__} does not say what its elasticity is")

    @property
    def features(self) -> tuple[float | None, float | None, float | None]:
        """(friction, cohesion, viscous damping), None for what the scene does not have.

        The type None makes Numba compile a kernel that holds no trace of that feature.
        """
        values = self.friction, self.cohesion, self.viscous_damping
        return tuple(float(value) or None for value in values)

    @property
    def turning(self) -> tuple[bool | None, bool | None]:
        """(projected, implicit): True for the scheme in use, None for others."""
        return self.scheme == "projection" or None, self.scheme == "implicit" or None

    def memory(self, dim: int) -> dict[str, slice]:
        """What a contact remembers beside its tangential force, and in which rows.

        Attributes of a `Packing`: rolling moments, 1 or 3 components; whether it is bonded.
        """
        moments = (1 if dim == 2 else 3) if self.rolling is not None else 0
        bonds = 1 if self.bonds is not None else 0
        return {"rolling": slice(0, moments), "bonded": slice(moments, moments + bonds)}


def must_be_positive(law: ContactLaw, *names: str) -> None:
    """Raise ValueError for values of a law that are not."""
    for name in names:
        value = getattr(law, name)
        if not (isfinite(value) and value > 0):
            raise ValueError(f"{type(law).__name__}: {name} must be positive, got {value}")


def must_be_at_least_zero(law: ContactLaw, *names: str) -> None:
    """Raise ValueError for values of a law that are not."""
    for name in names:
        value = getattr(law, name)
        if not (isfinite(value) and value >= 0):
            raise ValueError(f"{type(law).__name__}: {name} must be zero or positive, got {value}")
