"""What an element test says of the material: stiffness, friction angles, dilatancy, critical state.

Everything is computed from the deformation and the stress of its states. In 2D there is no third
axis: Young's modulus and Poisson's ratio are those of the plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .mixed_control import ElementState
from .reproducible import (
    arcsin,
    determinant,
    eigenvalues,
    inverse,
    log,
    product,
    slope,
    transposed,
)

#: Axial strain of the secant that modulus and Poisson's ratio are read from.
SECANT = 1e-3
#: Deviatoric strain around the peak that the dilatancy is fitted over.
AROUND_PEAK = 1e-2
#: Last share of a test that counts as the critical state.
CRITICAL = 0.25
#: Largest dilatancy angle, degrees, at which it does count.
STEADY = 6.0


@dataclass(frozen=True)
class Strength:
    """Summary of a compression or shear test; angles in degrees, moduli in Pa.

    NaN-free: what the test does not tell is None. critical_steady says whether the volume had
    become steady in the last quarter, which `critical_friction_angle` and `critical_void_ratio`
    are means over.
    """

    peak_friction_angle: float
    strain_at_peak: float
    dilatancy_angle: float | None
    critical_friction_angle: float | None
    critical_void_ratio: float | None
    critical_steady: bool
    young_modulus: float | None
    poisson_ratio: float | None


def friction_angle(stress: np.ndarray) -> np.ndarray:
    """Mobilised friction angle of stress (..., d, d), degrees, by the largest and least principal
    stresses: sin(phi) = (s_1 - s_3) / (s_1 + s_3); 0 without stress, 90 where one pulls.
    """
    principal = -eigenvalues(stress)
    most, least = principal[..., 0], principal[..., -1]
    total = most + least
    sine = np.divide(most - least, total, out=np.ones_like(total), where=total > 0)
    sine = np.where((most == 0) & (least == 0), 0.0, sine)
    return np.degrees(arcsin(np.clip(sine, 0.0, 1.0)))


def log_strain(deformation: np.ndarray) -> np.ndarray:
    """Principal logarithmic strains of F (..., d, d), compression positive, the largest last."""
    squared = product(deformation, transposed(deformation))
    return -0.5 * log(eigenvalues(squared))[..., ::-1]


def deviatoric_strain(deformation: np.ndarray) -> np.ndarray:
    """eps_q = sqrt(2 e : e) of F (..., d, d), e the deviator of the logarithmic strain (Guo-Zhao
    eq. 13)."""
    principal = log_strain(deformation)
    deviator = principal - principal.mean(-1, keepdims=True)
    return np.sqrt(2.0 * (deviator * deviator).sum(-1))


def dilatancy_angle(deformation: np.ndarray) -> float:
    """psi of a stretch of a test, degrees, from the deformations (n, d, d) along it.

    sin(psi) = -d eps_v / (2 d eps_1 - d eps_v), both strains compression positive and eps_1 that
    along which most compression goes on (Vermeer and de Borst 1984); in plane strain and in 2D
    that is -d eps_v / d gamma. The rates are slopes of straight lines through all points.
    """
    since = product(deformation, inverse(deformation[0]))
    rate = slope(log_strain(since)[:, -1], -log(determinant(since)))
    rate = 0.0 if abs(rate) < 1e-9 else rate  # constant volume, but for rounding
    return float(np.degrees(arcsin(np.clip(-rate / (2.0 - rate), -1.0, 1.0)))) + 0.0


def strength(
    states: Sequence[ElementState],
    initial: ElementState,
    void_ratio: float,
    secant: float = SECANT,
) -> Strength:
    """The summary of a test from its states.

    Args:
        states: in order, one or more.
        initial: the state before the first one.
        void_ratio: of that state.
        secant: axial strain up to which modulus and Poisson's ratio are taken.

    Raises ValueError without states.
    """
    if len(states) == 0:
        raise ValueError("strength: the test has no states")
    F = np.array([s.deformation for s in (initial, *states)])
    F = product(F, inverse(initial.deformation))
    stress = np.array([s.stress for s in (initial, *states)])
    angle, strain = friction_angle(stress), deviatoric_strain(F)
    voids = (1 + void_ratio) * determinant(F) - 1
    top = int(angle.argmax())
    near = np.abs(strain - strain[top]) <= AROUND_PEAK
    late = strain >= (1 - CRITICAL) * strain[-1]
    enough = late.sum() > 3 and strain[-1] > 5 * AROUND_PEAK
    drift = dilatancy_angle(F[late]) if enough else 0.0
    modulus, ratio = _elastic(F, stress, secant)
    return Strength(
        float(angle[top]),
        float(strain[top]),
        dilatancy_angle(F[near]) if near.sum() > 2 else None,
        float(angle[late].mean()) if enough else None,
        float(voids[late].mean()) if enough else None,
        bool(enough and abs(drift) < STEADY),
        modulus,
        ratio,
    )


def _elastic(F: np.ndarray, stress: np.ndarray, secant: float) -> tuple[float | None, float | None]:
    """Secant Young's modulus (Pa) and Poisson's ratio of a test with constant lateral stress."""
    axial = 1 - F[:, -1, -1]
    lateral = 1 - np.diagonal(F, axis1=1, axis2=2)[:, :-1].mean(1)
    side = -np.diagonal(stress, axis1=1, axis2=2)[:, :-1].mean(1)
    k = int(np.argmax(axial > 0.999 * secant))
    constant = abs(side[k] - side[0]) < 0.02 * abs(side[0])
    if not (constant and axial[k] > 0):
        return None, None
    modulus = (stress[0, -1, -1] - stress[k, -1, -1]) / axial[k]
    return float(modulus), float(-lateral[k] / axial[k])
