"""From F_i to F_f: the path, how long it takes, what is told of it, and objectivity."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.files import load_packing
from femxdem_fenicsx.dem.loading import logarithm, pressure_of, shear_of
from femxdem_fenicsx.dem.response import Response
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from tests.reference import DATA, reference_packing, table

BALANCED = PRESETS["balanced"]
SHORTER = np.diag([1.0009, 0.999])


def rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@pytest.fixture(scope="module")
def packing():
    return reference_packing()


@pytest.fixture(scope="module")
def sheared(packing):
    """The reference packing after 1 % of biaxial strain, brought to rest with care."""
    response = Response(packing, 1, BALANCED.but(tolerance=1e-5, hold_limit=50000))
    for _ in range(10):
        assert response.deform(SHORTER[None]).at_rest.all()
        response.commit()
    return response.committed.packing(0)


# Path


@pytest.mark.parametrize("degrees", [1e-6, 1.0, -10.0, 90.0, 170.0])
def test_the_logarithm_of_a_rotation_is_its_angle(degrees):
    angle = np.radians(degrees)
    np.testing.assert_allclose(
        logarithm(rotation(angle)), [[0, -angle], [angle, 0]], rtol=1e-11, atol=1e-14
    )


def test_the_logarithm_of_stretches_and_of_their_rotation_is_the_closed_form():
    stretch = np.diag([1.3, 0.6])
    np.testing.assert_allclose(logarithm(stretch), np.diag(np.log([1.3, 0.6])), atol=1e-13)
    R = rotation(0.7)
    np.testing.assert_allclose(
        logarithm(R @ stretch @ R.T), R @ np.diag(np.log([1.3, 0.6])) @ R.T, atol=1e-13
    )
    np.testing.assert_allclose(logarithm(2.5 * R), np.log(2.5) * np.eye(2) + logarithm(R))
    np.testing.assert_allclose(logarithm([[1.0, 3.0], [0.0, 1.0]]), [[0, 3], [0, 0]], atol=1e-13)
    assert (logarithm(np.eye(2)) == 0).all()


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-1.2, 1.2), min_size=8, max_size=8))
def test_the_logarithm_is_the_inverse_of_the_exponential_for_many_at_once(values):
    L = np.reshape(values, (2, 2, 2))
    F = np.array([expm(L[0]), expm(L[1])])
    np.testing.assert_allclose(logarithm(F), L, atol=1e-11)


def test_the_logarithm_of_one_does_not_depend_on_the_others():
    F = np.array([rotation(0.02) @ SHORTER, rotation(2.0), 3.0 * np.eye(2)])
    together = logarithm(F)
    for one, expected in zip(F, together, strict=True):
        np.testing.assert_array_equal(logarithm(one), expected)
    assert logarithm(np.zeros((0, 2, 2))).shape == (0, 2, 2)


@pytest.mark.parametrize(
    "bad",
    [np.diag([1.0, -1.0]), np.diag([1.0, 0.0]), np.full((2, 2), np.nan), np.diag([np.inf, 1])],
)
def test_what_is_no_deformation_is_refused_in_one_line(bad):
    with pytest.raises(ValueError, match="deformation gradient") as error:
        logarithm(np.array([np.eye(2), bad, np.eye(2)]))
    assert "\n" not in str(error.value)


def test_the_first_bad_deformation_is_named_by_its_number():
    F = np.broadcast_to(np.eye(2), (5, 2, 2)).copy()
    F[3] = -np.diag([1.0, -1.0])
    with pytest.raises(ValueError, match="deformation gradient 3 "):
        logarithm(F)


def test_exactly_half_a_turn_is_refused():
    with pytest.raises(ValueError, match="180 degrees"):
        logarithm(-np.eye(2)[None])


@pytest.mark.parametrize("degrees", [179.9, 180.0, -180.0, 180.01])
def test_half_a_turn_in_one_increment_is_refused(degrees):
    with pytest.raises(ValueError, match="180 degrees"):
        logarithm(np.array([np.eye(2), rotation(np.radians(degrees))]))


@pytest.mark.parametrize(
    ("log_F", "expected"),
    [
        (np.diag([0.1, -0.2]), 0.3),
        (np.diag([0.1, 0.05]), 0.1),  # out of the plane e = 0
        (np.diag([-0.1, -0.1]), 0.1),
        ([[0.0, 0.4], [0.0, 0.0]], 0.4),
        ([[0.0, -0.4], [0.4, 0.0]], 0.0),
    ],
)
def test_shear_is_the_difference_of_the_extreme_principal_strains(log_F, expected):
    assert shear_of(np.array([log_F]))[0] == pytest.approx(expected, abs=1e-15)


def test_pressure_is_compression_positive():
    assert pressure_of(np.diag([-3.0, -1.0])) == 2.0


def test_a_packing_that_collapses_in_its_hold_bears_nothing_any_more():
    """400 spheres at 7 % of a true triaxial test (b = 0.5, e = 0.63), almost without contacts to
    spare: they come to rest under 40 kPa, nearly, and fall apart after some 3500 steps."""
    packing = load_packing(DATA.parent / "spheres_about_to_collapse.h5", dim=3)
    strain = np.diag([1.22e-3, 9.5e-5, -2.7e-4])
    response = Response(packing, 2, BALANCED)
    outcome = response.deform(np.eye(3) + np.array([strain, 1.1 * strain]))
    assert (outcome.contacts < 0.1 * packing.size).all() and (outcome.hold_steps > 300).all()
    assert (np.abs(outcome.stress) < 100).all()


# Duration


def test_loading_takes_the_time_that_the_inertial_number_asks_for(packing):
    """tau = gamma d sqrt(rho / p) / I, Desrues eq. 18."""
    F = SHORTER[None]
    for number in (4e-3, 2e-3, 1e-3, 5e-4):
        response = Response(packing, 1, BALANCED.but(inertial_number=number))
        steps = int(response.deform(F).loading_steps[0])
        pressure = pressure_of(response.committed_outcome.stress[0])
        gamma = np.log(1.0009) - np.log(0.999)
        tau = gamma * packing.mean_diameter * np.sqrt(packing.density / pressure) / number
        assert steps == np.ceil(tau / response.loading.time_step * np.sqrt(1 + BALANCED.damping))
    assert steps > 100


def test_a_larger_strain_takes_longer_in_proportion(packing):
    response = Response(packing, 1, BALANCED)
    steps = [int(response.deform(expm(k * np.diag([1e-3, -1e-3]))[None]).loading_steps[0])
             for k in (1, 2, 4)]  # fmt: skip
    assert abs(steps[1] - 2 * steps[0]) <= 2
    assert abs(steps[2] - 4 * steps[0]) <= 4


# What is told


def test_a_hold_that_reaches_its_limit_is_reported_as_not_at_rest(packing):
    response = Response(packing, 2, BALANCED.but(tolerance=1e-6, hold_limit=25))
    assert not response.committed_outcome.at_rest.any()  # prepared with less care
    outcome = response.deform(np.array([np.eye(2), SHORTER]))
    assert not outcome.at_rest.any()
    assert (outcome.hold_steps == 25).all()
    assert (outcome.unbalance > 1e-6).all()


def test_a_packing_at_rest_has_the_unbalance_that_was_asked_for(packing):
    response = Response(packing, 1, BALANCED.but(tolerance=1e-4, hold_limit=20000))
    outcome = response.deform(SHORTER[None])
    assert outcome.at_rest.all()
    assert 0 < outcome.unbalance[0] < 1e-4
    assert outcome.hold_steps[0] % 25 == 0


def test_a_hold_of_a_packing_at_rest_keeps_stress_contacts_and_friction(sheared):
    """It turns by next to nothing: without any motion there is no hold."""
    response = Response(sheared, 1, BALANCED)
    before = response.committed_outcome.stress.copy()
    outcome = response.deform(rotation(1e-9)[None])
    assert outcome.hold_steps[0] == 25
    np.testing.assert_allclose(outcome.stress, before, atol=1e-4 * np.abs(before).max())
    assert outcome.contacts == response.committed_outcome.contacts
    response.commit()
    after = response.committed.packing(0)
    np.testing.assert_array_equal(after.contacts, sheared.contacts)
    largest = np.abs(sheared.tangential).max()
    np.testing.assert_allclose(after.tangential, sheared.tangential, atol=1e-3 * largest)


# Objectivity


@pytest.mark.parametrize("degrees", [10.0, -10.0, 100.0])
@pytest.mark.parametrize("accuracy", ["fast", "balanced", "reference"])
def test_a_rigid_rotation_rotates_the_stress_and_no_contact_slides(sheared, degrees, accuracy):
    R = rotation(np.radians(degrees))
    response = Response(sheared, 1, PRESETS[accuracy])
    before = response.committed_outcome.stress[0].copy()
    assert abs(before[0, 0] - before[1, 1]) > 0.3 * np.abs(before).max()
    after = response.deform(R[None]).stress[0].copy()
    np.testing.assert_allclose(after, R @ before @ R.T, atol=1e-4 * np.abs(before).max())
    response.commit()
    rotated = response.committed.packing(0)
    np.testing.assert_array_equal(rotated.contacts, sheared.contacts)
    largest = np.abs(sheared.tangential).max()
    np.testing.assert_allclose(rotated.tangential, sheared.tangential, atol=1e-3 * largest)


def test_a_rotation_moves_no_grain_against_the_others(sheared):
    """What is left after taking out the hold that a turn by next to nothing has too."""
    response = Response(sheared, 2, BALANCED)
    R = rotation(np.radians(10.0))
    still, turned = response.deform(np.array([rotation(1e-9), R])).stress
    np.testing.assert_allclose(turned, R @ still @ R.T, atol=1e-5 * np.abs(still).max())
    response.commit()
    still, turned = response.committed.packing(0), response.committed.packing(1)
    np.testing.assert_allclose(turned.box, R @ still.box, rtol=1e-8, atol=1e-15)
    moved = (turned.positions - still.positions) @ still.box.T
    assert np.abs(moved).max() < 1e-6 * still.mean_diameter


def test_a_stretch_in_a_turned_frame_gives_the_turned_stress(sheared):
    """sigma(R F R^T) of the turned packing is R sigma(F) R^T; damping alone knows the axes."""
    R = rotation(np.radians(30.0))
    turned = sheared.deformed(R)
    one, other = (Response(p, 1, PRESETS["reference"]) for p in (sheared, turned))
    F = np.array([[1.0004, 0.0003], [0.0, 0.9995]])
    stress = one.deform(F[None]).stress[0]
    expected = R @ stress @ R.T
    np.testing.assert_allclose(
        other.deform((R @ F @ R.T)[None]).stress[0], expected, atol=3e-3 * np.abs(stress).max()
    )


# Against YADE


def isochoric(accuracy, increments: int) -> tuple[np.ndarray, np.ndarray]:
    """(ours, YADE's) sxx, syy, sxy along YADE's constant-area path."""
    rows = table("isochoric.csv")
    law = HomogenisedLaw(reference_packing(), 1, accuracy)
    ours = []
    for strain in np.diff(rows["log_strain_or_gamma"])[:increments]:
        ours.append(law.evaluate(expm(np.diag([strain, -strain]))[None])[0][[0, 1, 0], [0, 1, 1]])
        law.commit()
    theirs = np.column_stack([rows[name][1:] for name in ("sxx_Pa", "syy_Pa", "sxy_Pa")])
    assert law.tally.unfinished == 0
    return np.array(ours), theirs[:increments]


def test_constant_area_compression_follows_yade_up_to_two_percent():
    ours, theirs = isochoric(BALANCED, 40)
    assert np.abs(ours - theirs).max() < 0.015 * np.abs(theirs).max()


def test_slow_constant_area_compression_has_yades_mean_stress_from_two_to_five_percent():
    ours, theirs = isochoric(BALANCED.but(inertial_number=1e-4), 100)
    largest = np.abs(theirs).max()
    ours, theirs = ours[40:].mean(0), theirs[40:].mean(0)
    np.testing.assert_allclose(ours[:2], theirs[:2], rtol=0.10)
    assert abs(ours[2] - theirs[2]) < 0.10 * largest
