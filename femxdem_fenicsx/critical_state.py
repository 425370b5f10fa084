"""The critical state at constant volume: mean pressure and friction angle by accuracy.

Past some 20 % of shear a packing flows at constant pressure, if its volume is kept. That pressure
is what undrained strength is made of, and a packing that is sheared too fast overestimates it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .dem.accuracy import Accuracy
from .dem.loading import pressure_of
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
    packings: Sequence[Packing], accuracy: Accuracy, shear: Shear = Shear(), threads: int = 1
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


def _bring_to(law: HomogenisedLaw, packings: Sequence[Packing], shear: Shear) -> None:
    """Strain every packing equally in all directions, until it has the void ratio asked for."""
    ratio = (1.0 + shear.void_ratio) / (1.0 + np.array([p.void_ratio for p in packings]))
    increments = max(int(np.ceil(np.abs(np.log(ratio)).max() / shear.step)), 1)
    stretch = ratio ** (1.0 / (law.dim * increments))
    F = stretch[:, None, None] * np.eye(law.dim)
    for _ in range(increments):
        law.evaluate(F)
        law.commit()
