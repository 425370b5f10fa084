"""The critical state at constant volume: mean pressure and friction angle by accuracy.

Past some 20 % of shear a packing flows at constant pressure, if its volume is kept. That pressure
is what undrained strength is made of, and a packing that is sheared too fast overestimates it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .dem.accuracy import PRESETS, Accuracy
from .dem.element_tests import simple_shear
from .dem.loading import pressure_of
from .dem.mixed_control import Servo
from .dem.packing import Packing
from .dem.reproducible import power
from .dem.strength import friction_angle
from .homogenised_law import HomogenisedLaw


@dataclass(frozen=True)
class Shear:
    """Simple shear at constant volume, once all packings have come to one void ratio.

    Attributes:
        void_ratio: that all packings are brought to while they are sheared to half of `first`, by
            equal strains in all directions; it is kept from then on.
        first, last: gamma between which pressure and friction angle are averaged.
        step: of gamma per increment.
    """

    void_ratio: float = 0.222
    first: float = 0.3
    last: float = 0.8
    step: float = 1e-3

    def __post_init__(self):
        if not 0 < self.step < 0.1 or not 0 <= self.first < self.last:
            raise ValueError(
                "critical state: need a step in ]0, 0.1[ and 0 <= first < last shear strain, got"
                f" {self.step}, {self.first} and {self.last}"
            )
        if not 0 < self.void_ratio < np.inf:
            raise ValueError(f"critical state: need a positive void ratio, got {self.void_ratio}")


#: What docs/accuracy.md has.
SHEAR = Shear()


@dataclass(frozen=True)
class Critical:
    """What packings (n,) had at the critical state.

    Attributes:
        pressure: mean pressure, Pa, compression positive. friction_angle: mobilised, degrees.
        steps: of the DEM per increment, mean over the packings and the increments averaged over.
    """

    pressure: np.ndarray
    friction_angle: np.ndarray
    steps: float

    def mean(self, name: str) -> tuple[float, float]:
        """Mean of an attribute over two or more packings, and the standard error of that mean."""
        values = getattr(self, name)
        return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))


def batch(packings: Sequence[Packing], accuracy: Accuracy, threads: int = 1) -> HomogenisedLaw:
    """Packings of the same grains and contact law, one at each point of a law."""
    states = [HomogenisedLaw(packing, 1, accuracy).state() for packing in packings]
    law = HomogenisedLaw(packings[0], 1, accuracy, threads=threads)
    law.restore({name: np.concatenate([s[name] for s in states]) for name in states[0]})
    return law


def critical_state(
    packings: Sequence[Packing], accuracy: Accuracy, shear: Shear = SHEAR, threads: int = 1
) -> Critical:
    """The packings, of the same grains, led to the critical state at constant volume."""
    law, path, stresses = batch(packings, accuracy, threads), _increments(packings, shear), []
    before = 0
    for k, F in enumerate(path):
        if k == round(shear.first / shear.step):
            before, stresses = law.tally.steps, []
        stresses.append(law.evaluate(F))
        law.commit()
    steps = (law.tally.steps - before) / (len(stresses) * len(packings))
    mean = np.mean(stresses, axis=0)
    return Critical(pressure_of(mean), friction_angle(mean), steps)


def critical_void_ratio(packing: Packing, shear: Shear = SHEAR, tolerance: float = 1e-2) -> float:
    """Mean void ratio of one packing at the critical state under its own vertical stress.

    By simple shear with the preset `fast`: the void ratio is only chosen by it.
    tolerance: on the vertical stress, over it.
    """
    law = HomogenisedLaw(packing, 1, PRESETS["fast"])
    normal = -float(law.stress[0, -1, -1])
    servo, ratios = Servo(law, tolerance * normal), []
    for state in simple_shear(servo, shear.last, shear.step, normal):
        if state.deformation[0, -1] > shear.first:
            ratios.append(float(law.void_ratio[0]))
    return float(np.mean(ratios))


def row(name: str, accuracy: Accuracy, found: Critical, reference: Critical) -> dict[str, object]:
    """A line of a table: what was found, its standard errors, the cost, off the reference."""
    (pressure, apart), (angle, angle_apart) = found.mean("pressure"), found.mean("friction_angle")
    expected, expected_apart = reference.mean("pressure")
    return {
        "accuracy": name,
        "inertial_number": accuracy.inertial_number,
        "tolerance": accuracy.tolerance,
        "packings": len(found.pressure),
        "dem_steps": found.steps,
        "pressure_Pa": pressure,
        "pressure_standard_error_Pa": apart,
        "friction_angle_deg": angle,
        "friction_angle_standard_error_deg": angle_apart,
        "pressure_error": pressure / expected - 1.0,
        "pressure_error_standard_error": float(np.hypot(apart, expected_apart)) / expected
        if found is not reference
        else 0.0,
    }


def presets(
    packings: Sequence[Packing], shear: Shear = SHEAR, threads: int = 1
) -> list[dict[str, object]]:
    """A `row` for each preset, from the fastest on; errors are against `reference`."""
    found = {
        name: critical_state(packings, accuracy, shear, threads)
        for name, accuracy in PRESETS.items()
    }
    return [row(name, PRESETS[name], found[name], found["reference"]) for name in PRESETS]


def _increments(packings: Sequence[Packing], shear: Shear) -> Iterator[np.ndarray]:
    """F (n, d, d) of each increment; the void ratio is reached halfway to `shear.first`."""
    dim, count = packings[0].dim, len(packings)
    ratio = (1.0 + shear.void_ratio) / (1.0 + np.array([p.void_ratio for p in packings]))
    dilating = max(round(0.5 * shear.first / shear.step), 1)
    simple = np.eye(dim)
    simple[0, -1] = shear.step
    stretch = power(ratio, 1.0 / (dim * dilating))
    for k in range(round(shear.last / shear.step)):
        yield (stretch if k < dilating else np.ones(count))[:, None, None] * simple
