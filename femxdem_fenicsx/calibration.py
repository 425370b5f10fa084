"""E_c and mu for a target modulus and friction angle, by drained compression of a few packings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import lsq_linear

from .dem.contacts import LinearContact
from .dem.element_tests import drained_compression
from .dem.preparation import NotReached, random_packing
from .dem.reproducible import exp, log, rounded
from .dem.strength import Strength
from .laboratory import Specimen, finish, specimen

#: Step of ln(E_c) and ln(mu) to the first neighbours: its effect is far above the scatter.
STEP = 0.25
#: Furthest that ln(E_c) and ln(mu) move from the best answer at once.
FURTHEST = 1.0
#: Axial strain of an increment of the tests.
LOAD_STEP = 1e-3
#: Range of mu that is searched; beyond 2 contacts hardly slide and no angle changes any more.
FRICTIONS = (0.01, 2.0)
#: Contact moduli are searched within this factor of the first guess.
RANGE = 100.0


@dataclass(frozen=True)
class Answer:
    """What packings with E_c (Pa) and mu answer: means over the seeds and standard errors.

    young_modulus and its error in Pa, friction_angle and its error in degrees.
    """

    modulus: float
    friction: float
    young_modulus: float
    young_modulus_error: float
    friction_angle: float
    friction_angle_error: float


@dataclass(frozen=True)
class Target:
    """Young's modulus (Pa) and friction angle (degrees).

    peak: whether the angle is that of the peak, or the critical one. secant: axial strain up to
    which the modulus is taken. The larger it is, the less the modulus follows E_c: grains slide
    before.
    """

    young_modulus: float
    friction_angle: float
    peak: bool = True
    secant: float = 1e-3

    def __post_init__(self):
        if not 0 < self.young_modulus < np.inf:
            raise ValueError(f"target modulus must be positive (Pa), got {self.young_modulus}")
        if not 1e-5 <= self.secant < 0.1:
            raise ValueError(f"secant: give an axial strain in [1e-5, 0.1[, got {self.secant}")
        if not 0 < self.friction_angle < 90:
            raise ValueError(
                f"target friction angle must be between 0 and 90 degrees, got {self.friction_angle}"
            )

    def angle_of(self, told: Strength) -> float:
        """The angle that is meant; ValueError where the test was too short to tell it."""
        angle = told.peak_friction_angle if self.peak else told.critical_friction_angle
        if angle is None:
            raise ValueError("the test is too short to see a critical state; take more strain")
        return angle


@dataclass
class Calibration:
    """The outcome: the best answer, all that were computed, whether it meets the target."""

    target: Target
    best: Answer
    answers: list[Answer] = field(default_factory=list)


@dataclass(frozen=True)
class Laboratory:
    """Packings of several seeds, prepared and tested with any E_c and mu.

    They are prepared anew every time. Packings that are only brought back to the pressure with
    another E_c are not the same: with stiffer contacts they lose most of them on the way (400 disks
    from 0.6 to 2.1 GPa, Young's modulus 39 MPa in place of 88 MPa).

    Attributes:
        law: gives all but E_c and mu; ValueError where it has no modulus.
        pressure: Pa, of the preparation and of the tests.
        strain: axial, of the tests.
        seeds: one packing each.
        threads: of this process.
        preparation: what `random_packing` takes besides.
    """

    target: Target
    law: LinearContact
    pressure: float
    strain: float
    seeds: tuple[int, ...]
    threads: int = 1
    preparation: dict = field(default_factory=dict)

    def __post_init__(self):
        if getattr(self.law, "modulus", None) is None:
            raise ValueError("calibration needs a contact law with a modulus E_c")

    def test(self, modulus: float, friction: float) -> list[Specimen]:
        """The packings after drained compression with this E_c (Pa) and mu."""
        law = replace(self.law, modulus=modulus, friction=friction)
        fine = max(int(np.ceil(LOAD_STEP / self.target.secant)), 5)

        def one(seed: int) -> Specimen:
            packing = random_packing(law=law, pressure=self.pressure, seed=seed, **self.preparation)
            made = specimen(packing)
            test = drained_compression(made.servo, self.pressure, self.strain, LOAD_STEP, fine=fine)
            finish(made, test)
            return made

        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(one, self.seeds))

    def answer(self, modulus: float, friction: float) -> Answer:
        """Means over the packings."""
        return answer_of(self.test(modulus, friction), modulus, friction, self.target)


def answer_of(tests: Sequence[Specimen], modulus: float, friction: float, target: Target) -> Answer:
    """Means and standard errors of tests with this E_c and mu."""
    told = [made.strength_with(target.secant) for made in tests]
    if any(strength.young_modulus is None for strength in told):
        raise NotReached("calibration: a test did not keep its lateral pressure from the beginning")
    moduli = np.array([strength.young_modulus for strength in told])
    angles = np.array([target.angle_of(strength) for strength in told])

    def error(values: np.ndarray) -> float:
        return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0

    return Answer(
        modulus, friction, float(moduli.mean()), error(moduli), float(angles.mean()), error(angles)
    )


def calibrate(
    answer: Callable[[float, float], Answer],
    target: Target,
    start: tuple[float, float],
    tolerance: tuple[float, float] = (0.05, 0.5),
    most: int = 15,
    progress: Callable[[Answer], None] = lambda answer: None,
) -> Calibration:
    """E_c and mu for the target.

    Both answers are nearly straight lines over ln(E_c) and ln(mu), with the scatter of the grains
    on top, which is as large as what a small step changes. So a plane is fitted to all answers,
    those near the best one counting most, and the point where it meets the target is tried next
    (`scipy.optimize.lsq_linear`, within the bounds).

    Args:
        answer: of E_c (Pa) and mu, e.g. `Laboratory.answer`.
        target: wanted.
        start: E_c and mu of the first guess.
        tolerance: relative one on the modulus, and one on the angle, degrees.
        most: answers; the first four are the start and its neighbours.
        progress: called with every new answer.

    Raises ValueError for a start out of range, and NotReached, with the best answer, where the
    target is not met.
    """
    modulus, friction = start
    if not (0 < modulus < np.inf and FRICTIONS[0] <= friction <= FRICTIONS[1]):
        raise ValueError(
            f"calibration starts with a positive modulus and a friction in {FRICTIONS}, got {start}"
        )
    low = log(np.array([1 / RANGE, FRICTIONS[0] / friction]))  # over the start, as all places
    high = log(np.array([RANGE, FRICTIONS[1] / friction]))
    places, errors, answers = [], [], []
    neighbours = STEP * np.array([[0, 0], [1, 0], [0, 1], [-1, -1]])
    for number in range(max(most, len(neighbours))):
        if number < len(neighbours):
            place = np.clip(neighbours[number], low, high)
        else:
            place = _next(np.array(places), np.array(errors), low, high)
        answers.append(answer(*(float(value) for value in start * exp(place))))
        progress(answers[-1])
        places.append(place)
        errors.append(_errors(answers[-1], target, tolerance))
        if np.abs(errors[-1]).max() <= 1.0:
            return Calibration(target, answers[-1], answers)
    best = answers[int(np.argmin(np.abs(errors).max(1)))]
    raise NotReached(
        f"calibration: the target, {1e-6 * target.young_modulus:.4g} MPa and"
        f" {target.friction_angle:.3g} degrees, was not met in {len(answers)} answers; at best"
        f" {1e-6 * best.young_modulus:.4g} MPa and {best.friction_angle:.3g} degrees with"
        f" E_c = {best.modulus:.4g} Pa and mu = {best.friction:.4g}; take more seeds if these"
        " scatter, another density if the angle is out of reach, a smaller secant if the modulus is"
    )


def _next(places: np.ndarray, errors: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(2,) where a plane through the errors (n, 2) at the places (n, 2) vanishes."""
    best = places[np.abs(errors).max(1).argmin()]
    weight = np.exp(-0.5 * ((places - best) ** 2).sum(1) / (3 * STEP) ** 2)[:, None]
    plane = np.column_stack([np.ones(len(places)), places - best])
    fit, *_ = np.linalg.lstsq(weight * plane, weight * errors, rcond=None)
    near_low, near_high = np.maximum(low - best, -FURTHEST), np.minimum(high - best, FURTHEST)
    move = lsq_linear(fit[1:].T, -fit[0], (near_low, near_high)).x
    return best + rounded(move)


def _errors(found: Answer, target: Target, tolerance: tuple[float, float]) -> np.ndarray:
    """(2,) off the target, over the tolerance."""
    return np.array([
        log(found.young_modulus / target.young_modulus) / tolerance[0],
        (found.friction_angle - target.friction_angle) / tolerance[1],
    ])  # fmt: skip
