"""Friction and dilatancy angles, moduli and the critical state of curves that are known."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.mixed_control import ElementState
from femxdem_fenicsx.dem.strength import dilatancy_angle, friction_angle, strength

CONFINING = 1e5


def test_the_friction_angle_is_that_of_the_largest_and_least_principal_stress():
    sine = np.sin(np.radians(30.0))
    ratio = (1 + sine) / (1 - sine)
    turned = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    stress = turned @ np.diag([-1e5, -ratio * 1e5]) @ turned.T
    assert friction_angle(stress) == pytest.approx(30.0)
    spatial = np.diag([-1e5, -1.5e5, -ratio * 1e5])
    assert friction_angle(spatial) == pytest.approx(30.0)
    assert friction_angle(np.zeros((2, 2))) == 0.0
    assert friction_angle(np.diag([1e5, -2e5])) == 90.0


@pytest.mark.parametrize("psi", [-10.0, 0.0, 12.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_dilatancy_angle_of_a_steady_flow(psi, dim):
    sine = np.sin(np.radians(psi))
    axial = np.linspace(0, 0.02, 21)
    volume = -2 * axial * sine / (1 - sine)  # from sin(psi) = -dv / (2 de_1 - dv)
    lateral = (volume - axial) / (dim - 1)
    F = np.array(
        [np.diag(np.exp([-y] * (dim - 1) + [-x])) for x, y in zip(axial, lateral, strict=True)]
    )
    assert dilatancy_angle(F) == pytest.approx(psi, abs=1e-6)


def soil(strain: float, steps: int = 300) -> list[ElementState]:
    """E = 20 MPa and nu = 0.2, a peak of ratio 3 at 2 %, a critical state of 2; it dilates by
    sin(psi) = 0.2 between 1 and 3 %, and not any more behind 10 %."""
    axial = np.linspace(0, strain, steps + 1)
    points = [0.0, 1e-3, 0.02, 0.1, 1.0]
    ratio = np.interp(axial, points, [1.0, 1.2, 3.0, 2.0, 2.0])
    slope = -2 * 0.2 / (1 - 0.2)  # of the logarithmic volume over the logarithmic axial strain
    log_axial = -np.log1p(-axial)
    volume = np.interp(
        log_axial, [0.0, 1e-3, 0.01, 0.03, 0.1, 1.0],
        [0.0, 8e-4, 8e-4, 8e-4 + slope * 0.02, 8e-4 + slope * 0.03, 8e-4 + slope * 0.03],
    )  # fmt: skip
    width = np.exp(log_axial - volume)
    return [
        ElementState(np.diag([w, 1 - a]), -CONFINING * np.diag([1.0, r]), 1, 0.0)
        for w, a, r in zip(width, axial, ratio, strict=True)
    ]


def test_the_summary_of_a_known_soil():
    initial, *states = soil(0.3)
    told = strength(states, initial, void_ratio=0.18)
    assert told.peak_friction_angle == pytest.approx(30.0, abs=0.1)
    assert told.critical_friction_angle == pytest.approx(np.degrees(np.arcsin(1 / 3)), abs=0.1)
    assert told.dilatancy_angle == pytest.approx(np.degrees(np.arcsin(0.2)), abs=0.3)
    end = states[-1].deformation
    assert told.critical_void_ratio == pytest.approx(1.18 * np.linalg.det(end) - 1, abs=1e-4)
    assert told.critical_steady
    assert told.young_modulus == pytest.approx(20e6, rel=1e-2)
    assert told.poisson_ratio == pytest.approx(0.2, abs=2e-2)


def test_the_critical_state_is_the_mean_over_the_last_quarter_of_the_deviatoric_strain():
    """At constant volume, eps_q = -2 ln(1 - axial), and an angle that falls in a straight line."""
    strain = np.linspace(0, 0.4, 401)
    axial = 1 - np.exp(-strain / 2)
    sine = np.sin(np.radians(40 - 25 * strain))
    initial, *states = (
        ElementState(np.diag([1 / (1 - a), 1 - a]), -CONFINING * np.diag([1 - s, 1 + s]), 1, 0.0)
        for a, s in zip(axial, sine, strict=True)
    )
    told = strength(states, initial, 0.18)
    assert told.critical_friction_angle == pytest.approx(40 - 25 * 0.35, abs=0.05)
    assert told.critical_void_ratio == pytest.approx(0.18) and told.critical_steady


def test_a_test_that_is_too_short_tells_no_critical_state_and_a_drifting_one_says_so():
    initial, *states = soil(0.02)
    told = strength(states, initial, 0.18)
    assert told.critical_friction_angle is None and told.critical_void_ratio is None
    assert not told.critical_steady
    initial, *states = soil(0.03)
    assert not strength(states, initial, 0.18).critical_steady  # still dilates
    with pytest.raises(ValueError, match="no states"):
        strength([], initial, 0.18)


def test_without_constant_lateral_stress_there_is_no_young_modulus():
    initial, *states = soil(0.3)
    states = [
        ElementState(s.deformation, s.stress * (1 + 100 * s.axial_strain), 1, 0.0) for s in states
    ]
    told = strength(states, initial, 0.18)
    assert told.young_modulus is None and told.poisson_ratio is None
