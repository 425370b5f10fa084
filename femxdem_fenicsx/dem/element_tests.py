"""Element tests of the soil laboratory, one material point on its own, state by state.

The last axis is the vertical one, and shear displaces the top along the first axis. Every test
takes a `Servo`, which knows the state, and can follow another test: consolidate, then shear.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from .load_path import Leg
from .mixed_control import ElementState, Servo, StressCondition, increment
from .reproducible import geometric, product

__all__ = [
    "ElementState",
    "along",
    "constant_volume_compression",
    "cyclic_shear",
    "drained_biaxial",
    "drained_compression",
    "increment",
    "isotropic_compression",
    "oedometric_compression",
    "simple_shear",
    "true_triaxial",
]

#: Mean pressure over the first one below which a packing has liquefied: a test ends there.
LIQUEFIED = 0.01


def drained_compression(
    law,
    confining: float,
    strain: float,
    step: float = 1e-3,
    free_shear: bool = False,
    tolerance: float = 1e-3,
    fine: int = 1,
) -> Iterator[ElementState]:
    """Axial compression along the last axis under constant lateral pressure; state by state.

    In 2D that is a biaxial test, in 3D a triaxial one.

    Args:
        law: of size 1, two- or three-dimensional, or a `Servo` over one.
        confining: lateral pressure, Pa, compression positive.
        strain: engineering axial strain to reach, compression positive.
        step: of it per increment.
        free_shear: whether the box may shear sideways so that the shear stress vanishes, as a
            specimen between smooth plates may, or is kept rectangular.
        tolerance: of the prescribed stress, over the confining pressure; a `Servo` has its own.
        fine: increments that the first step is cut into, to see the stiffness at small strain.
    """
    servo = law if isinstance(law, Servo) else Servo(law, tolerance * confining, most=40)
    d = servo.law.dim
    controlled = np.diag(np.arange(d) < d - 1) | np.triu(np.full((d, d), free_shear), 1)
    condition = StressCondition.components(controlled, -confining * np.eye(d))
    height = servo.deformation[-1, -1]
    for F in _targets(servo, strain, step, fine):
        F[-1, -1] = height * (1 - F[-1, -1])
        yield servo.to(F, condition)


drained_biaxial = drained_compression


def constant_volume_compression(
    servo: Servo, strain: float, step: float = 1e-3, fine: int = 1
) -> Iterator[ElementState]:
    """Axial compression at constant volume, as of a saturated specimen that cannot drain.

    strain, step, fine: as in `drained_compression`. The stress is the effective one.
    """
    start = servo.deformation.copy()
    d = len(start)
    for F in _targets(servo, strain, step, fine):
        height = 1 - F[-1, -1]
        width = 1 / height if d == 2 else 1 / np.sqrt(height)
        yield servo.to(product(np.diag([width] * (d - 1) + [height]), start))


def oedometric_compression(
    servo: Servo, strain: float, step: float = 1e-3, fine: int = 1
) -> Iterator[ElementState]:
    """Axial compression without lateral strain; a negative strain unloads."""
    height = servo.deformation[-1, -1]
    for F in _targets(servo, strain, step, fine):
        F[-1, -1] = height * (1 - F[-1, -1])
        yield servo.to(F)


def isotropic_compression(
    servo: Servo, pressure: float, increments: int = 20
) -> Iterator[ElementState]:
    """From the mean pressure that there is to another one, Pa, in steps of equal ratio.

    All sides move on their own; the box stays rectangular.
    """
    d = servo.law.dim
    first = max(servo.pressure, 1e-3 * pressure)
    for p in geometric(first, pressure, increments + 1)[1:]:
        condition = StressCondition.components(np.eye(d, dtype=bool), -p * np.eye(d))
        yield servo.to(servo.deformation, condition)


def simple_shear(
    servo: Servo, strain: float, step: float = 1e-3, normal: float | None = None, fine: int = 1
) -> Iterator[ElementState]:
    """Shear to gamma = `strain` from where it is; the sides keep their width.

    normal: vertical stress that is kept, Pa, compression positive; at constant volume if None.
    """
    start = servo.shear
    for F in _targets(servo, strain, step, fine):
        yield _shear(servo, start + F[-1, -1], normal)


def _shear(servo: Servo, gamma: float, normal: float | None) -> ElementState:
    """Shear to the total gamma = F_1d."""
    d = servo.law.dim
    F = servo.deformation.copy()
    F[0, -1] = gamma
    if normal is None:
        return servo.to(F)
    vertical = np.diag(np.arange(d) == d - 1)
    return servo.to(F, StressCondition.components(vertical, -normal * np.eye(d)))


def cyclic_shear(
    servo: Servo,
    cycles: int,
    amplitude: float | None = None,
    stress: float | None = None,
    step: float = 5e-4,
    normal: float | None = None,
    largest: float = 0.1,
) -> Iterator[ElementState]:
    """Simple shear to and fro (Guo-Zhao section 5), until the packing has liquefied.

    Give one of `amplitude` (gamma, strain controlled) and `stress` (Pa, stress controlled): shear
    turns round where |gamma| or |sigma_1d| has reached it. A stress-controlled test ends as well
    where |gamma| exceeds `largest`: the packing does not bear that stress any more (cyclic
    mobility).

    Args:
        servo: at the beginning of the test.
        cycles: of shear at most.
        amplitude, stress: see above.
        step: of gamma per increment.
        normal: vertical stress that is kept, Pa; at constant volume if None.
        largest: gamma at which a stress-controlled test ends.

    Raises ValueError where not exactly one of amplitude and stress is given.
    """
    if (amplitude is None) == (stress is None):
        raise ValueError("cyclic shear: give either a strain amplitude or a shear stress, not both")
    start, first = servo.shear, servo.pressure
    for half in range(2 * cycles + 1):
        sense = 1.0 if half % 2 == 0 else -1.0
        last = half == 2 * cycles
        while True:
            gamma = servo.shear + sense * step
            if amplitude is not None:
                limit = start + (0.0 if last else sense * amplitude)
                gamma = sense * min(sense * gamma, sense * limit)
            state = _shear(servo, gamma, normal)
            yield state
            if state.pressure < LIQUEFIED * first:
                return
            if amplitude is not None:
                turns = abs(gamma - limit) < 1e-9
            else:
                turns = sense * state.stress[0, -1] >= (0.0 if last else stress)
                if abs(gamma - start) > largest:
                    return
            if turns:
                break


def true_triaxial(
    servo: Servo, strain: float, b: float, step: float = 1e-3, fine: int = 1
) -> Iterator[ElementState]:
    """Compression of spheres at constant mean pressure and b = (s_2 - s_3) / (s_1 - s_3).

    The last axis has the major stress s_1, the second one s_2, the first one s_3. b = 0 is triaxial
    compression, b = 1 triaxial extension. ValueError for disks and for b outside [0, 1].
    """
    if servo.law.dim != 3:
        raise ValueError("true triaxial test: it needs spheres; disks have no third axis")
    if not 0 <= b <= 1:
        raise ValueError(f"true triaxial test: b must be in [0, 1], got {b}")
    rows = np.array([np.eye(3), np.diag([b - 1.0, 1.0, -b])])
    free = np.diag([True, True, False])
    condition = StressCondition(free, rows, np.array([np.trace(servo.stress), 0.0]))
    height = servo.deformation[-1, -1]
    for F in _targets(servo, strain, step, fine):
        F[-1, -1] = height * (1 - F[-1, -1])
        yield servo.to(F, condition)


def along(servo: Servo, legs: Sequence[Leg]) -> Iterator[ElementState]:
    """Along a user's own path, see `load_path`: from leg to leg in straight lines."""
    for leg in legs:
        F, stress = servo.deformation.copy(), servo.stress.copy()
        for share in np.arange(1, leg.increments + 1) / leg.increments:
            condition = StressCondition.components(
                leg.controlled, stress + share * (leg.stress - stress)
            )
            straight = F + share * (leg.deformation - F)
            yield servo.to(np.where(leg.strained, straight, servo.deformation), condition)


def _targets(servo: Servo, strain: float, step: float, fine: int) -> Iterator[np.ndarray]:
    """The F of this moment with the strain so far, by steps, in its last component."""
    steps = max(round(abs(strain) / step), 1)
    whole = strain * np.arange(1, steps + 1) / steps
    first = whole[0] * np.arange(1, fine) / fine
    for value in np.concatenate([first, whole]):
        F = servo.deformation.copy()
        F[-1, -1] = value
        yield F
