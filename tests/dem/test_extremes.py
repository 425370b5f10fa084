"""The micro scale at its extremes: what works there, and what is refused in one line.

docs/stability.md has the table, with larger packings.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from femxdem_fenicsx.dem.accuracy import PRESETS, Accuracy
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.homogenisation import elastic_energy
from femxdem_fenicsx.dem.packing import Packing
from femxdem_fenicsx.dem.preparation import random_packing
from femxdem_fenicsx.dem.response import Response
from femxdem_fenicsx.homogenised_law import HomogenisedLaw

from .scenes import FRICTIONLESS, STIFFNESS, Moving, chain, hexagonal

FAST, BALANCED = PRESETS["fast"], PRESETS["balanced"]
SHORTER = np.diag([1.0008, 0.999])
PRESSURE = 1e5


def law_of(level: float, pressure: float = PRESSURE, friction: float = 0.5) -> LinearContact:
    """Contacts with that stiffness level k_n / (p t): t is 20 mean radii."""
    return LinearContact(modulus=20 * level * pressure, stiffness_ratio=0.8, friction=friction)


@pytest.fixture(scope="module")
def packing() -> Packing:
    return random_packing(64)


def strained(packing: Packing, accuracy: Accuracy = FAST, F=SHORTER, increments: int = 3):
    """The law after some equal increments."""
    law = HomogenisedLaw(packing, 1, accuracy)
    for _ in range(increments):
        law.evaluate(np.asarray(F, float)[None])
        law.commit()
    assert np.isfinite(law.stress).all()
    return law


def stress_after(*args, **options) -> np.ndarray:
    return strained(*args, **options).stress[0]


# Units


def in_other_units(packing: Packing, length: float = 1.0, pressure: float = 1.0) -> Packing:
    """The same packing with all lengths and all stresses that many times as large."""
    law = replace(packing.law, modulus=pressure * packing.law.modulus)
    return packing.but(
        box=length * packing.box,
        radii=length * packing.radii,
        thickness=length * packing.thickness,
        law=law,
        contacts=packing.contacts,
        tangential=length**2 * pressure * packing.tangential,
    )


@pytest.mark.parametrize("length", [1e-6, 1e3])
@pytest.mark.parametrize("pressure", [1e-5, 1e4])  # 1 Pa to 1 GPa
def test_results_scale_with_the_units_of_length_and_pressure(packing, length, pressure):
    expected = pressure * stress_after(packing)
    other = stress_after(in_other_units(packing, length, pressure))
    np.testing.assert_allclose(other, expected, atol=1e-8 * np.abs(expected).max())


def test_density_makes_no_difference_to_a_packing_that_is_deformed_slowly(packing):
    """The inertial number scales the rate, so that even the steps are the same."""
    expected = stress_after(packing)
    other = stress_after(packing.but(density=20 * packing.density))
    np.testing.assert_allclose(other, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("power", [-20, 10])  # micrometres, kilometres; rounding is the same
def test_a_packing_is_prepared_alike_in_any_unit_of_length(packing, power):
    unit = 2.0**power
    other = random_packing(64, (3e-3 * unit, 7e-3 * unit))
    np.testing.assert_array_equal(other.positions, packing.positions)
    np.testing.assert_array_equal(other.box, unit * packing.box)


# Settings


@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
def test_any_time_step_up_to_the_limit_gives_the_same_stress(packing, share):
    law = strained(packing, BALANCED.but(time_step=share))
    assert law.tally.unfinished == 0
    expected = stress_after(packing, BALANCED)
    np.testing.assert_allclose(law.stress[0], expected, atol=2e-2 * np.abs(expected).max())


def test_a_time_step_above_the_limit_is_refused():
    with pytest.raises(ValueError, match=r"time_step 2\.0 is above the stability limit"):
        BALANCED.but(time_step=2.0)


@pytest.mark.parametrize("damping", [0.0, 0.3, 0.9, 0.99])
def test_the_limit_with_damping_is_that_of_springs_as_much_stiffer(damping):
    """omega^2 = (1 + damping) 4 k_n / m where the grains of a chain swing against each other."""
    line = chain(0, FRICTIONLESS)
    limit = 2 / np.sqrt(4 * STIFFNESS * (1 + damping) / line.masses[0])

    def growth(share: float) -> float:
        """Largest speed ever over the first, from several phases of the swing."""
        largest = 0.0
        for phase in np.linspace(0, np.pi, 8, endpoint=False):
            swing = 1e-9 * np.outer([1, -1] * 3, [1.0, 0.0])
            shifted = line.positions + 0.5 * limit * np.cos(phase) * swing / line.box[0, 0]
            moving = Moving(line.but(positions=shifted), np.sin(phase) * swing)
            for _ in range(40):
                moving.advance(10, share * limit, damping=damping)
                largest = max(largest, np.abs(moving.velocity).max())
        return largest / 1e-9

    assert growth(0.98) < 10
    assert growth(1.02) > 1000


@pytest.mark.parametrize(("damping", "hold_damping"), [(0.0, 0.0), (0.0, 0.99), (0.99, 0.5)])
def test_any_damping_comes_to_rest_at_the_same_stress(packing, damping, hold_damping):
    law = strained(packing, BALANCED.but(damping=damping, hold_damping=hold_damping))
    assert law.tally.unfinished == 0
    expected = stress_after(packing, BALANCED)
    np.testing.assert_allclose(law.stress[0], expected, atol=2e-2 * np.abs(expected).max())


@pytest.mark.parametrize("level", [30.0, 1e7])
def test_soft_and_stiff_contacts_make_packings_that_answer(level):
    packing = random_packing(64, law=law_of(level))
    law = strained(packing, increments=5)
    assert law.tally.unfinished == 0
    assert 0.08 < packing.void_ratio < 0.23
    assert law.tally.worst_overlap < 6 / level + 0.02
    axial, lateral = -law.stress[0, 1, 1], -law.stress[0, 0, 0]
    assert axial > lateral > 0


def test_a_pressure_that_squashes_the_grains_is_refused_at_once():
    with pytest.raises(ValueError, match="overlap by about 100% of their diameter: they are too"):
        random_packing(64, pressure=1e9)
    with pytest.raises(ValueError, match=r"overlap by about 3\d%"):
        random_packing(64, law=law_of(3.0))


def test_more_contacts_than_there_is_room_for_are_named(packing, monkeypatch):
    monkeypatch.setattr("femxdem_fenicsx.dem.packing.CONTACTS_PER_GRAIN", {2: 1})
    response = Response(packing.but(contacts=np.zeros((0, 2)), tangential=np.zeros(0)), 2, FAST)
    with pytest.raises(FloatingPointError, match=r"packing 1: more than 1\.0 contacts per grain"):
        response.deform(np.array([np.eye(2), SHORTER]))


@pytest.mark.parametrize("friction", [0.0, 1e-6, 10.0, 1e6])
def test_any_friction_is_computed_and_more_of_it_makes_the_packing_stronger(packing, friction):
    law = strained(packing.but(law=replace(packing.law, friction=friction)), increments=10)
    assert law.tally.unfinished == 0
    q, ordinary = (s[0, 0] - s[1, 1] for s in (law.stress[0], stress_after(packing, increments=10)))
    assert q > ordinary if friction > 1 else q < 0.5 * ordinary


def test_friction_as_low_as_1e_6_is_as_good_as_none_and_10_as_good_as_1e6(packing):
    """To what two ways of computing the same packing part by in an increment of 0.1 %."""
    for few, many in ((0.0, 1e-6), (10.0, 1e6)):
        one, other = (
            stress_after(packing.but(law=replace(packing.law, friction=mu)), increments=1)
            for mu in (few, many)
        )
        np.testing.assert_allclose(one, other, atol=3e-2 * np.abs(one).max())


# Grains


@pytest.mark.parametrize("grains", [1, 2, 4])
def test_too_few_grains_are_refused_at_once_with_how_many_it_takes(grains, monkeypatch):
    monkeypatch.setattr("femxdem_fenicsx.dem.preparation.compress", None)  # nothing computed
    with pytest.raises(ValueError, match=f"^grains: with {grains} .* use more grains, 5 at least"):
        random_packing(grains)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sixteen_grains_are_a_packing(seed):
    law = strained(random_packing(16, seed=seed), BALANCED)
    assert law.tally.unfinished == 0
    assert (law.stress[0].diagonal() < -1e4).all()


def test_ten_thousand_grains_answer_as_a_hundred_of_the_same_lattice():
    """Every cell of a lattice deforms alike, however many there are."""
    law = law_of(300.0)
    one, many = (stress_after(hexagonal(k, k, law=law), increments=1) for k in (10, 100))
    np.testing.assert_allclose(many, one, rtol=1e-3, atol=1e-3 * np.abs(one).max())


def test_radii_may_differ_by_a_factor_of_twenty():
    shares = []
    for seed in (2, 3, 5):
        law = strained(random_packing(200, (1e-3, 2e-2), seed=seed), BALANCED, increments=5)
        for _ in range(2):
            law.evaluate(0.98 * np.eye(2)[None])
            law.commit()
        assert law.tally.unfinished <= 1  # of seven; a small grain may rattle on
        shares.append(law.response.time_step[0] / law.response.loading.time_step)
    # a small grain that gets one more contact shortens the stable time step, in most packings
    assert max(shares) <= 1.0 and min(shares) < 0.99


# Strains


def test_a_thousand_strains_of_1e_12_and_of_nothing_leave_the_stress_as_it_is(packing):
    law = strained(packing)
    before, steps = law.stress.copy(), law.tally.steps
    for strain in (1e-12, 0.0):
        for _ in range(1000):
            law.evaluate((np.eye(2) + strain * np.diag([1.0, -1.0]))[None])
            law.commit()
        np.testing.assert_array_equal(law.stress, before)
    assert law.tally.steps == steps


def test_a_packing_not_at_rest_goes_on_with_its_hold_where_nothing_moves(packing):
    response = Response(packing, 1, FAST.but(hold_limit=25, tolerance=1e-7))
    response.deform(SHORTER[None])
    response.commit()
    holds = 0
    while not response.committed_outcome.at_rest.all():
        assert response.deform(np.eye(2)[None]).hold_steps[0] == 25
        response.commit()
        holds += 1
    assert holds > 2
    assert response.committed_outcome.unbalance[0] < 1e-7
    assert response.deform(np.eye(2)[None]).hold_steps[0] == 0


def test_holds_without_strain_converge_and_do_not_creep(packing):
    """Turned to and fro by 1e-9: the stress settles within the tolerance, and stays there."""
    law, stresses = strained(packing), []
    for k in range(300):
        angle = 1e-9 if k % 2 else -1e-9
        law.evaluate((np.eye(2) + angle * np.array([[0.0, -1.0], [1.0, 0.0]]))[None])
        law.commit()
        stresses.append(law.stress[0])
    moved = np.abs(np.array(stresses) - stresses[0]).max((1, 2)) / PRESSURE
    assert moved.max() < 1e-2
    np.testing.assert_allclose(stresses[100:], stresses[-1:] * 200, atol=1e-5 * PRESSURE)


def test_ten_percent_of_strain_in_one_increment_is_a_state_near_that_of_a_hundred(packing):
    one = stress_after(packing, F=np.diag([1.08, 0.9]), increments=1)
    F = np.diag(np.array([1.08, 0.9]) ** 0.01)
    many = stress_after(packing, F=F, increments=100)
    assert np.linalg.norm(one - many) < 0.5 * np.linalg.norm(many)


def test_three_hundred_percent_of_shear_reduce_the_box_and_go_on():
    law = strained(random_packing(100), F=[[1.0, 0.1], [0.0, 1.0]], increments=30)
    assert law.deformation[0, 0, 1] == pytest.approx(3.0)
    assert law.tally.unfinished == 0
    assert (np.linalg.eigvalsh(law.stress[0]) < 0).all()
    assert law.void_ratio[0] == pytest.approx(law.packing(0).void_ratio)


def test_three_hundred_percent_at_once_are_refused_where_the_box_gets_too_low(packing):
    with pytest.raises(ValueError, match="packing 0: its box is squeezed below two diameters"):
        Response(packing, 1, FAST).deform(np.array([[[1.0, 3.0], [0.0, 1.0]]]))


def test_a_packing_may_be_compressed_to_half_its_height_but_not_to_nothing_but_grains(packing):
    law = strained(packing, F=np.diag([1.05, 0.95]), increments=14)
    assert law.deformation[0, 1, 1] < 0.5
    assert law.tally.unfinished == 0
    with pytest.raises(ValueError, match=r"packing 0: its box is squeezed to 0\.\d\d of the"):
        Response(packing, 1, FAST).deform(np.diag([1.0, 0.5])[None])


def test_a_liquefied_packing_regains_its_stiffness_when_pushed_together_again(packing):
    law = HomogenisedLaw(packing, 1, FAST)
    pressures, contacts, failed = [], [], []
    for F in [1.002 * np.eye(2)] * 10 + [np.eye(2) / 1.002] * 10:
        law.evaluate(F[None])
        law.commit()
        pressures.append(-np.trace(law.stress[0]) / 2)
        contacts.append(law.coordination_number[0])
        failed.append(bool(law.failed[0]))
    assert pressures[9] == contacts[9] == 0.0
    assert (failed[0], failed[9], failed[-1]) == (False, True, False)
    assert pressures[-1] > 0.5 * PRESSURE
    # about: the pressure that it counts with is measured, and differs with the packing's bits
    assert law.tally.largest_inertial_number == pytest.approx(10 * FAST.inertial_number, rel=0.25)


def test_tension_is_answered_by_no_stress_and_no_stiffness_that_is_not_finite(packing):
    law = strained(packing, F=np.diag([1.01, 1.0]), increments=5)
    assert law.stress[0, 0, 0] > -1e-3 * PRESSURE
    assert np.isfinite(law.tangent()).all()


# Random settings


@settings(max_examples=25, deadline=None)
@given(
    number=st.floats(-4, -1),
    tolerance=st.floats(-4, -1),
    time_step=st.floats(0.2, 1.0),
    damping=st.floats(0.0, 0.95),
    hold_damping=st.floats(0.1, 0.95),
    strain=st.lists(st.floats(-2e-3, 2e-3), min_size=4, max_size=4),
    angle=st.floats(-1.0, 1.0),
)
def test_whatever_the_settings_and_the_strain(
    packing, number, tolerance, time_step, damping, hold_damping, strain, angle
):
    """Stress is a function of F, symmetric at rest, objective; no energy comes from nowhere."""
    accuracy = Accuracy(
        inertial_number=10**number,
        tolerance=10**tolerance,
        time_step=time_step,
        damping=damping,
        hold_damping=hold_damping,
    )
    F = np.eye(2) + np.reshape(strain, (2, 2))
    response = Response(packing, 1, accuracy)
    before = response.committed_outcome.stress[0]
    outcome = response.deform(F[None])
    stress = outcome.stress[0]
    scale = np.abs(stress).max() + PRESSURE
    response.deform(np.diag([0.99, 1.003])[None])  # another trial must not matter
    np.testing.assert_array_equal(response.deform(F[None]).stress[0], stress)

    if outcome.at_rest[0]:
        assert abs(stress[0, 1] - stress[1, 0]) < 3 * accuracy.tolerance * scale

    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])
    turned = response.deform((R @ F)[None]).stress[0]
    np.testing.assert_allclose(turned, R @ stress @ R.T, atol=3e-2 * scale)

    response.deform(F[None])
    response.commit()
    after = response.committed.packing(0)
    work = 0.5 * (((stress + before) * (F - np.eye(2))).sum()) * packing.volume
    gained = elastic_energy(after) - elastic_energy(packing)
    assert gained < work + 0.1 * abs(work) + 0.05 * elastic_energy(packing)
