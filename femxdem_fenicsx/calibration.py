"""E_c and mu for a target modulus and friction angle, by drained compression of a few packings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from .dem.element_tests import drained_compression
from .dem.packing import Packing
from .dem.preparation import NotReached, compress, random_packing
from .dem.strength import Strength
from .laboratory import Specimen, finish, specimen

#: Step of ln(E_c) and ln(mu) in the search's derivatives: far above the scatter of the tests.
STEP = 0.25
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
    """Young's modulus (Pa, secant at 0.1 % of axial strain) and friction angle (degrees).

    peak: whether the angle is that of the peak, or the critical one.
    """

    young_modulus: float
    friction_angle: float
    peak: bool = True

    def __post_init__(self):
        if not 0 < self.young_modulus < np.inf:
            raise ValueError(f"target modulus must be positive (Pa), got {self.young_modulus}")
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


class Laboratory:
    """Packings of several seeds, prepared once, that are tested with any E_c and mu."""

    def __init__(
        self, packings: Sequence[Packing], pressure: float, strain: float, target: Target,
        threads: int = 1,
    ):  # fmt: skip
        """Packings at rest under `pressure` (Pa), to be compressed to an axial strain.

        Raises ValueError for contact laws without a modulus.
        """
        if any(getattr(packing.law, "modulus", None) is None for packing in packings):
            raise ValueError("calibration needs a contact law with a modulus E_c")
        self.packings, self.pressure, self.strain = packings, pressure, strain
        self.target, self.threads = target, threads

    def test(self, modulus: float, friction: float) -> list[Specimen]:
        """The packings tested with this E_c (Pa) and mu, at rest under the pressure before."""

        def one(packing: Packing) -> Specimen:
            law = replace(packing.law, modulus=modulus, friction=friction)
            return tested(compress(packing.but(law=law), self.pressure), self.pressure, self.strain)

        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(one, self.packings))

    def answer(self, modulus: float, friction: float) -> Answer:
        """Means over the packings."""
        return answer_of(self.test(modulus, friction), modulus, friction, self.target)


def tested(packing: Packing, pressure: float, strain: float) -> Specimen:
    """A packing in drained compression, fine at first."""
    made = specimen(packing)
    finish(made, drained_compression(made.servo, pressure, strain, 1e-3, fine=5))
    return made


def answer_of(tests: Sequence[Specimen], modulus: float, friction: float, target: Target) -> Answer:
    """Means and standard errors of tests with this E_c and mu."""
    told = [made.strength for made in tests]
    if any(strength.young_modulus is None for strength in told):
        raise NotReached("calibration: a test did not keep its lateral pressure from the beginning")
    moduli = np.array([strength.young_modulus for strength in told])
    angles = np.array([target.angle_of(strength) for strength in told])

    def error(values: np.ndarray) -> float:
        return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0

    return Answer(
        modulus, friction, float(moduli.mean()), error(moduli), float(angles.mean()), error(angles)
    )


def prepare(
    seeds: Sequence[int], pressure: float, threads: int = 1, **preparation
) -> list[Packing]:
    """Random packings of these seeds; `preparation` as for `random_packing`."""
    with ThreadPoolExecutor(threads) as pool:
        return list(
            pool.map(
                lambda seed: random_packing(seed=seed, pressure=pressure, **preparation), seeds
            )
        )


def calibrate(
    answer: Callable[[float, float], Answer],
    target: Target,
    start: tuple[float, float],
    tolerance: tuple[float, float] = (0.03, 0.5),
    most: int = 8,
    progress: Callable[[Answer], None] = lambda answer: None,
) -> Calibration:
    """E_c and mu for the target, by scipy's least squares over ln(E_c) and ln(mu).

    The same packings are tested every time, so that their scatter does not hide the slopes, which
    are taken over wide steps.

    Args:
        answer: of E_c (Pa) and mu, e.g. `Laboratory.answer`.
        target: wanted.
        start: E_c and mu of the first guess.
        tolerance: relative one on the modulus, and one on the angle, degrees.
        most: iterations, of three answers each.
        progress: called with every new answer.

    Raises ValueError for a start out of range, and NotReached, with the best answer, where the
    target is not met.
    """
    modulus, friction = start
    if not (modulus > 0 and FRICTIONS[0] <= friction <= FRICTIONS[1]):
        raise ValueError(
            f"calibration starts with a positive modulus and a friction in {FRICTIONS}, got {start}"
        )
    known: dict[tuple[float, float], Answer] = {}
    low = np.log([modulus / RANGE, FRICTIONS[0]])
    high = np.log([modulus * RANGE, FRICTIONS[1]])

    def errors(x: np.ndarray) -> np.ndarray:
        key = tuple(float(v) for v in np.round(np.exp(x), 12))
        if key not in known:
            known[key] = answer(*key)
            progress(known[key])
        return _errors(known[key], target, tolerance)

    def slopes(x: np.ndarray) -> np.ndarray:
        here, columns = errors(x), []
        for k in range(2):
            step = np.zeros(2)
            step[k] = STEP if x[k] + STEP < high[k] else -STEP
            columns.append((errors(x + step) - here) / step[k])
        return np.column_stack(columns)

    class Met(Exception):
        pass

    def until_met(x: np.ndarray) -> np.ndarray:
        found = errors(x)
        if np.abs(found).max() <= 1.0:
            raise Met
        return found

    try:
        least_squares(
            until_met, np.log([modulus, friction]), slopes, bounds=(low, high), xtol=1e-2,
            ftol=1e-2, max_nfev=most,
        )  # fmt: skip
    except Met:
        pass
    answers = list(known.values())
    best = min(answers, key=lambda found: np.abs(_errors(found, target, tolerance)).max())
    if np.abs(_errors(best, target, tolerance)).max() > 1.0:
        raise NotReached(
            f"calibration: the target, {1e-6 * target.young_modulus:.4g} MPa and"
            f" {target.friction_angle:.3g} degrees, was not met in {len(answers)} answers; at best"
            f" {1e-6 * best.young_modulus:.4g} MPa and {best.friction_angle:.3g} degrees with"
            f" E_c = {best.modulus:.4g} Pa and mu = {best.friction:.4g}"
        )
    return Calibration(target, best, answers)


def _errors(found: Answer, target: Target, tolerance: tuple[float, float]) -> np.ndarray:
    """(2,) off the target, over the tolerance."""
    return np.array([
        np.log(found.young_modulus / target.young_modulus) / tolerance[0],
        (found.friction_angle - target.friction_angle) / tolerance[1],
    ])  # fmt: skip
