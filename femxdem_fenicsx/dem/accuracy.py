"""What a user trades: speed of the micro scale against its accuracy."""

import warnings
from dataclasses import dataclass, fields, replace


@dataclass(frozen=True)
class Accuracy:
    """How slowly a packing is deformed and how long it is held afterwards.

    Attributes:
        inertial_number: I of the loading (Desrues eq. 17-18); smaller is slower and more accurate.
        tolerance: largest net force on a grain over the largest contact force, at which the hold
            ends (Desrues eq. 19).
        hold_limit: most steps of one hold; where it is reached, that is counted and reported.
        time_step: share of the stability limit of the packing at hand, damping included, in ]0, 1].
            At 1 some holds swing on and on: contacts that form within an increment count later.
        damping: local non-viscous damping while loading (Guo-Zhao eq. 18).
        hold_damping: the same during the hold, where no motion is meant to survive.
    """

    inertial_number: float = 1e-3
    tolerance: float = 1e-2
    hold_limit: int = 4000
    time_step: float = 0.95
    damping: float = 0.3
    hold_damping: float = 0.5

    def __post_init__(self):
        for name in ("inertial_number", "tolerance", "time_step"):
            if not getattr(self, name) > 0:
                raise ValueError(f"Accuracy: {name} must be positive, got {getattr(self, name)}")
        if self.time_step > 1:
            raise ValueError(
                f"Accuracy: time_step {self.time_step} is above the stability limit; use 1 or less"
            )
        if not self.hold_limit >= 1:
            raise ValueError(f"Accuracy: hold_limit must be 1 or more, got {self.hold_limit}")
        for name in ("damping", "hold_damping"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"Accuracy: {name} must be in [0, 1[, got {getattr(self, name)}")

    def but(self, **changes) -> "Accuracy":
        """A copy with some attributes changed."""
        unknown = set(changes) - {field.name for field in fields(self)}
        if unknown:
            raise ValueError(f"Accuracy: unknown setting {', '.join(sorted(unknown))}")
        return replace(self, **changes)


#: Presets by name, chosen from the tables in docs/accuracy.md. `reference` are the settings of
#: Desrues (section 2.4).
#: `fast` is for drained problems and for strains below 2 %. It is not for undrained strength, for
#: liquefaction, nor for cycles at constant volume: there the mean pressure of the critical state is
#: a third too high with it (friction angles are right). `balanced` is damped less than the others,
#: which is right to 3 % there; with 1e-3 and a damping of 0.3 that pressure is a tenth too high.
PRESETS = {
    "fast": Accuracy(inertial_number=5e-3, tolerance=3e-2),
    "balanced": Accuracy(inertial_number=7e-4, tolerance=1e-2, damping=0.1),
    "reference": Accuracy(inertial_number=1e-4, tolerance=1e-3, hold_limit=20000),
}


def preset(name: str) -> Accuracy:
    """The preset of that name; ValueError with the known names otherwise."""
    if name not in PRESETS:
        raise ValueError(f"unknown accuracy preset '{name}'; choose from {', '.join(PRESETS)}")
    return PRESETS[name]


def warn_of_rate(accuracy: Accuracy, test: str) -> None:
    """Warn of a test at constant volume that is made faster than `balanced` is."""
    most = PRESETS["balanced"].inertial_number
    if accuracy.inertial_number > most:
        warnings.warn(
            f"{test}: at constant volume an inertial number of {accuracy.inertial_number:g} gives"
            f" too much pressure (docs/accuracy.md); use {most:g} or less (balanced, reference)",
            stacklevel=2,
        )
