"""An element test from beginning to end: a packing, a servo over it, a row of numbers per state."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from .dem.accuracy import PRESETS, Accuracy
from .dem.element_tests import LIQUEFIED, isotropic_compression
from .dem.homogenisation import fabric_anisotropy
from .dem.mixed_control import ElementState, Servo
from .dem.packing import Packing
from .dem.preparation import NotReached, check_stiffness
from .dem.reproducible import determinant, inverse, log, product
from .dem.strength import SECANT, Strength, deviatoric_strain, friction_angle, strength
from .homogenised_law import HomogenisedLaw

AXES = "xyz"
#: Tolerance of prescribed stress over the mean pressure.
TOLERANCE = 3e-3
#: Pressures that differ by no more than this share are the same.
SAME = 1e-2


@dataclass
class Specimen:
    """A packing in the laboratory.

    Attributes:
        packing: at the beginning. law: over it, of one material point. servo: over the law.
        initial: the state that a test starts from. states: of the test so far. rows: the same as
        numbers to write down, the first one the initial state's.
    """

    packing: Packing
    law: HomogenisedLaw
    servo: Servo
    initial: ElementState = field(init=False)
    states: list[ElementState] = field(default_factory=list)
    rows: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self):
        self.start()

    def start(self) -> None:
        """Let the test begin at the state of this moment."""
        servo = self.servo
        self.initial = ElementState(servo.deformation.copy(), servo.stress, 0, 0.0)
        self.initial_void_ratio = float(self.law.void_ratio[0])
        self.states, self.rows = [], [self._row(self.initial)]

    def follow(
        self,
        test: Iterable[ElementState],
        progress: Callable[[ElementState], None] = lambda state: None,
    ) -> list[ElementState]:
        """Go through a test and keep its states; NotReached leaves those up to there."""
        for state in test:
            self.states.append(state)
            self.rows.append(self._row(state))
            progress(state)
        return self.states

    @property
    def strength(self) -> Strength:
        """Summary of the test; ValueError without states."""
        return self.strength_with(SECANT)

    def strength_with(self, secant: float) -> Strength:
        """The same with the modulus up to another axial strain."""
        return strength(self.states, self.initial, self.initial_void_ratio, secant)

    @property
    def now(self) -> Packing:
        """The packing as it stands."""
        return self.law.packing(0)

    def _row(self, state: ElementState) -> dict[str, float]:
        """Numbers of a state: normal components compression positive, shear as F_ij and sigma_ij;
        strain since the beginning of the test."""
        F = product(state.deformation, inverse(self.initial.deformation))
        stress, dim = state.stress, len(F)
        row: dict[str, float] = {}
        for i in range(dim):
            row[f"strain_{2 * AXES[i]}"] = float(1 - F[i, i])
        for i, j in zip(*np.triu_indices(dim, 1), strict=True):
            row[f"gamma_{AXES[i]}{AXES[j]}"] = float(F[i, j])
        for i in range(dim):
            row[f"stress_{2 * AXES[i]}_Pa"] = float(-stress[i, i])
        for i, j in zip(*np.triu_indices(dim, 1), strict=True):
            row[f"tau_{AXES[i]}{AXES[j]}_Pa"] = float(stress[i, j])
        outcome = self.law.response.committed_outcome
        return row | {
            "volumetric_strain": float(determinant(F)) - 1.0,
            "deviatoric_strain": float(deviatoric_strain(F)),
            "pressure_Pa": state.pressure,
            "friction_angle_deg": float(friction_angle(stress)),
            "void_ratio": float(self.law.void_ratio[0]),
            "coordination_number": float(self.law.coordination_number[0]),
            "fabric_anisotropy": float(fabric_anisotropy(outcome.fabric[0])),
            "stress_error_Pa": state.error,
            "evaluations": state.evaluations,
            "reached": int(state.reached),
            "at_rest": int(outcome.at_rest[0]),
        }


def specimen(
    packing: Packing,
    pressure: float | None = None,
    accuracy: Accuracy = PRESETS["balanced"],
    tolerance: float = TOLERANCE,
) -> Specimen:
    """A packing ready to be tested, consolidated to a mean pressure (Pa) if one is given.

    tolerance: on prescribed stress, over that pressure. Raises ValueError for a packing without
    pressure and values that are not possible, NotReached where the pressure is not.
    """
    if pressure is not None and not (np.isfinite(pressure) and pressure > 0):
        raise ValueError(f"pressure must be positive (Pa), got {pressure}")
    if pressure is not None:
        check_stiffness(packing, pressure)
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance must be in ]0, 1[, got {tolerance}")
    law = HomogenisedLaw(packing, 1, accuracy)
    there = -float(np.trace(law.stress[0])) / packing.dim
    if not there > 0:
        raise ValueError("the packing bears no pressure: prepare it under one before it is tested")
    wanted = there if pressure is None else pressure
    servo = Servo(law, tolerance * wanted)
    made = Specimen(packing, law, servo)
    if abs(there - wanted) > SAME * wanted:
        increments = max(int(np.ceil(10 * abs(log(wanted / there)))), 5)
        made.follow(isotropic_compression(servo, wanted, increments))
        made.start()
    return made


def finish(made: Specimen, test: Iterable[ElementState], progress=lambda state: None) -> str | None:
    """Follow a test to its end; why it ended early, or None."""
    try:
        made.follow(test, progress)
    except NotReached as error:
        return str(error)
    return None


def summary(made: Specimen) -> dict[str, float | bool | None]:
    """What the test tells, by name: all that any test may tell; angles in degrees.

    bulk_modulus_Pa: pressure over volumetric strain of the first increment. oedometric_modulus_Pa:
    axial stress over axial strain up to 0.1 %. lateral_ratio: lateral over axial stress increment
    at the largest axial stress. The others: see `dem.strength.Strength`.
    """
    told, rows = made.strength, made.rows
    axis = "xyz"[made.packing.dim - 1]
    plane = "xy" if made.packing.dim == 2 else "xz"
    axial = np.array([row[f"stress_{2 * axis}_Pa"] for row in rows])
    lateral = np.array([row["stress_xx_Pa"] for row in rows])
    strain = np.array([row[f"strain_{2 * axis}"] for row in rows])
    pressure = np.array([row["pressure_Pa"] for row in rows])
    top, k = int(axial.argmax()), max(int(np.argmax(strain > 0.999 * SECANT)), 1)
    return {
        "peak_friction_angle": told.peak_friction_angle,
        "strain_at_peak": told.strain_at_peak,
        "dilatancy_angle": told.dilatancy_angle,
        "critical_friction_angle": told.critical_friction_angle,
        "critical_void_ratio": told.critical_void_ratio,
        "critical_steady": told.critical_steady,
        "young_modulus_Pa": told.young_modulus,
        "poisson_ratio": told.poisson_ratio,
        "bulk_modulus_Pa": _ratio(pressure[1] - pressure[0], -rows[1]["volumetric_strain"]),
        "oedometric_modulus_Pa": _ratio(axial[k] - axial[0], strain[k]),
        "lateral_ratio": _ratio(lateral[top] - lateral[0], axial[top] - axial[0]),
        "largest_shear_strain": max(abs(row[f"gamma_{plane}"]) for row in rows),
        "least_pressure_Pa": float(pressure.min()),
        "liquefied": bool(pressure[-1] < LIQUEFIED * pressure[0]),
    }


def _ratio(above: float, below: float) -> float | None:
    return float(above / below) if abs(below) > 1e-12 else None
