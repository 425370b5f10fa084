"""The critical state at constant volume: mean pressure and friction angle by accuracy.

Past some 20 % of shear a packing flows at constant pressure, if its volume is kept. That pressure
is what undrained strength is made of, and a packing that is sheared too fast overestimates it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .dem.accuracy import PRESETS, Accuracy
from .dem.element_tests import simple_shear
from .dem.loading import pressure_of
from .dem.mixed_control import Servo
from .dem.packing import Packing
from .dem.strength import friction_angle
from .homogenised_law import HomogenisedLaw


@dataclass(frozen=True)
class Shear:
    """Simple shear at constant volume, after a dilation or compression to one void ratio.

    Attributes:
        void_ratio: that all packings are brought to first, by equal strains in all directions.
        first, last: gamma between which pressure and friction angle are averaged.
        step: of gamma per increment, and of the volumetric strain per increment before.
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
        steps: of the DEM per increment of shear, mean over all packings and increments.
    """

    pressure: np.ndarray
    friction_angle: np.ndarray
    steps: float

    def mean(self, name: str) -> tuple[float, float]:
        """Mean over the packings of an attribute, and the standard error of that mean."""
        values = getattr(self, name)
        error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.inf
        return float(values.mean()), float(error)


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
    law, dim = batch(packings, accuracy, threads), packings[0].dim
    _bring_to(law, packings, shear)
    F = np.broadcast_to(np.eye(dim), (len(packings), dim, dim)).copy()
    F[:, 0, -1] = shear.step
    before, total = law.tally.steps, round(shear.last / shear.step)
    stresses = []
    for k in range(1, total + 1):
        stress = law.evaluate(F)
        law.commit()
        if k > round(shear.first / shear.step):
            stresses.append(stress)
    stresses = np.array(stresses)
    steps = (law.tally.steps - before) / (total * len(packings))
    mean = stresses.mean(0)
    return Critical(pressure_of(mean), np.array([friction_angle(s) for s in mean]), steps)


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


def _bring_to(law: HomogenisedLaw, packings: Sequence[Packing], shear: Shear) -> None:
    """Strain every packing equally in all directions, until it has the void ratio asked for."""
    ratio = (1.0 + shear.void_ratio) / (1.0 + np.array([p.void_ratio for p in packings]))
    increments = max(int(np.ceil(np.abs(np.log(ratio)).max() / shear.step)), 1)
    stretch = ratio ** (1.0 / (law.dim * increments))
    F = stretch[:, None, None] * np.eye(law.dim)
    for _ in range(increments):
        law.evaluate(F)
        law.commit()
