"""Packings behind the Law protocol: state, files, failed packings, bad input."""

import inspect
from dataclasses import replace

import h5py
import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.homogenisation import coordination_number, fabric, touching
from femxdem_fenicsx.dem.homogenisation import fabric_anisotropy as anisotropy_of
from femxdem_fenicsx.dem.homogenisation import stress as stress_of
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from femxdem_fenicsx.law import InadmissibleDeformation, Law
from tests.reference import reference_packing

FAST, SIZE = PRESETS["fast"], 3


@pytest.fixture(scope="module")
def packing():
    return reference_packing()


def increments(seed: int, size: int = SIZE) -> np.ndarray:
    return np.eye(2) + 2e-3 * np.random.default_rng(seed).uniform(-1, 1, (size, 2, 2))


def walked(packing, operator_name: str = "UKO", steps: int = 2) -> HomogenisedLaw:
    law = HomogenisedLaw(packing, SIZE, FAST, operator_name)
    for seed in range(steps):
        law.evaluate(increments(seed))
        law.commit()
    return law


# The protocol


def test_it_has_all_that_the_law_protocol_asks_for(packing):
    law = HomogenisedLaw(packing, SIZE, FAST)
    assert (law.dim, law.size) == (2, SIZE)
    methods = [n for n, member in vars(Law).items() if inspect.isfunction(member) and n[0] != "_"]
    assert len(methods) == 6
    for name in methods:
        expected = list(inspect.signature(getattr(Law, name)).parameters)[1:]
        assert list(inspect.signature(getattr(law, name)).parameters) == expected
    assert law.evaluate(increments(0)).shape == (SIZE, 2, 2)
    assert law.tangent().shape == (SIZE, 2, 2, 2, 2)


def test_evaluate_is_a_function_of_F_alone_whatever_was_tried_before(packing):
    law = walked(packing)
    first = law.evaluate(increments(7)).copy()
    law.tangent()
    law.evaluate(np.eye(2) + 10 * (increments(8) - np.eye(2)))
    with pytest.raises(InadmissibleDeformation):
        law.evaluate(np.full((SIZE, 2, 2), np.nan))
    law.discard()
    law.commit()
    np.testing.assert_array_equal(law.evaluate(increments(7)), first)


def test_friction_of_its_own_is_that_of_a_packing_of_such_grains(packing, tmp_path):
    """And it moves and is stored with the packing."""
    friction = np.array([0.3, 0.5, 0.3])
    law = HomogenisedLaw(packing, SIZE, FAST, friction=friction)
    compression = np.tile(np.diag([1.002, 0.99]), (SIZE, 1, 1))
    stress = law.evaluate(compression)
    law.commit()
    for point, value in enumerate(friction):
        grains = packing.but(law=replace(packing.law, friction=value))
        alone = HomogenisedLaw(grains, 1, FAST)
        np.testing.assert_array_equal(alone.evaluate(compression[:1])[0], stress[point])
        assert law.packing(point).law.friction == value
    assert abs(stress[0, 1, 1]) < 0.97 * abs(stress[1, 1, 1])
    other = HomogenisedLaw(packing, SIZE, FAST, friction=0.5 * np.ones(SIZE))
    with h5py.File(tmp_path / "state.h5", "w") as file:
        law.save(file)
        other.load(file)
    np.testing.assert_array_equal(other.evaluate(compression), law.evaluate(compression))


def test_friction_that_is_not_positive_is_refused(packing):
    with pytest.raises(ValueError, match="must be positive"):
        HomogenisedLaw(packing, SIZE, FAST, friction=np.array([0.5, 0.0, 0.5]))


def test_what_evaluate_returns_is_the_callers_own(packing):
    law = HomogenisedLaw(packing, SIZE, FAST)
    law.evaluate(increments(0))[:] = 0.0
    law.commit()
    assert (law.stress[:, 0, 0] < -1e4).all()


def test_an_error_does_not_turn_the_last_good_trial_into_something_else(packing):
    law = walked(packing)
    good = law.evaluate(increments(5)).copy()
    with pytest.raises(InadmissibleDeformation):
        law.evaluate(np.zeros((SIZE, 2, 2)))
    law.commit()
    np.testing.assert_array_equal(law.stress, good)


@pytest.mark.parametrize(
    "bad",
    [np.full((2, 2), np.nan), np.diag([1.0, 0.0]), np.diag([1.0, -1.0]), -np.diag([1.0, -1.0])],
    ids=["NaN", "flat", "inside out", "inside out the other way"],
)
def test_an_F_that_is_no_deformation_is_inadmissible_and_names_the_point(packing, bad):
    F = increments(0)
    F[1] = bad
    with pytest.raises(InadmissibleDeformation, match="deformation gradient 1 ") as error:
        HomogenisedLaw(packing, SIZE, FAST).evaluate(F)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("shape", [(2, 2), (SIZE - 1, 2, 2), (SIZE, 3, 3), (SIZE, 4)])
def test_an_F_of_another_shape_is_a_mistake_of_the_program(packing, shape):
    with pytest.raises(ValueError, match="shape") as error:
        HomogenisedLaw(packing, SIZE, FAST).evaluate(np.zeros(shape))
    assert not isinstance(error.value, InadmissibleDeformation)


def test_an_unknown_operator_is_answered_with_the_known_ones(packing):
    with pytest.raises(ValueError, match=r"'XYZ'.*CTO, AEO, UKO"):
        HomogenisedLaw(packing, SIZE, FAST, "XYZ")


def test_a_rank_without_points_goes_through_all_the_motions(packing):
    law = HomogenisedLaw(packing, 0, FAST)
    assert law.evaluate(np.zeros((0, 2, 2))).shape == (0, 2, 2)
    assert law.tangent().shape == (0, 2, 2, 2, 2)
    law.commit()
    law.discard()
    assert law.fabric_anisotropy.shape == law.failed.shape == (0,)


def test_strains_far_below_what_grains_can_resolve_change_no_bit(packing):
    """What the linear solver rounds differently on 1 and 2 ranks must not reach the grains."""
    law, noise = HomogenisedLaw(packing, 1, FAST), 1e-14 * np.array([[3.0, -2.0], [1.0, -4.0]])
    F = (np.eye(2) + np.array([[5.0, 1.0], [-2.0, -9.0]]) * 2.0**-13)[None]
    np.testing.assert_array_equal(law.evaluate(F + noise), law.evaluate(F))
    assert (law.evaluate(F + 1e-8) != law.evaluate(F)).any()


# What it tells


def test_measures_are_those_of_the_committed_packings(packing):
    law = walked(packing)
    law.evaluate(increments(9))  # a trial does not count
    total = increments(1) @ increments(0)
    np.testing.assert_allclose(law.deformation, total, atol=1e-8)  # strains are rounded
    for b in range(SIZE):
        one = law.packing(b)
        contacts = touching(one)
        scale = np.abs(law.stress[b]).max()
        # a mean over the looks since it was nearly at rest (`loading.share_of_look`)
        np.testing.assert_allclose(law.stress[b], stress_of(one), atol=2e-3 * scale)
        assert law.void_ratio[b] == pytest.approx(one.void_ratio)
        assert law.coordination_number[b] == coordination_number(one)
        assert law.fabric_anisotropy[b] == pytest.approx(anisotropy_of(fabric(contacts)))
        small = 0.5 * (total[b] + total[b].T) - np.eye(2)
        deviator = small - 0.5 * np.trace(small) * np.eye(2)
        norm = np.sqrt(2 * (deviator**2).sum())
        assert law.deviatoric_strain[b] == pytest.approx(norm, rel=1e-2)
    assert not law.failed.any()


def test_the_steps_to_load_are_known_before_and_those_to_hold_are_as_the_last(packing):
    law = walked(packing)
    held = law.response.outcome.hold_steps
    for seed, size in ((5, 1.0), (6, 10.0), (7, 0.0)):
        F = np.eye(2) + size * (increments(seed) - np.eye(2))
        expected = law.expected_cost(F)
        law.evaluate(F)
        outcome = law.response.outcome
        still = (size == 0) & (outcome.loading_steps == 0)  # at rest, and asked for nothing
        np.testing.assert_array_equal(expected, np.where(still, 0, outcome.loading_steps + held))
        held = np.where(still, held, outcome.hold_steps)
    assert still.any() and outcome.loading_steps.max() < 10  # none to speak of, where F = I
    with pytest.raises(InadmissibleDeformation):
        law.expected_cost(-F)


def test_the_tally_counts_what_was_done_and_holds_that_did_not_end(packing):
    law = HomogenisedLaw(packing, SIZE, FAST.but(hold_limit=25, tolerance=1e-8))
    law.evaluate(increments(0))
    first = law.response.outcome
    steps = (first.loading_steps + first.hold_steps).sum()
    worst = first.unbalance.max()
    law.evaluate(increments(1))
    tally = law.tally
    steps += (law.response.outcome.loading_steps + law.response.outcome.hold_steps).sum()
    worst = max(worst, law.response.outcome.unbalance.max())
    assert (tally.evaluations, tally.packings, tally.steps) == (2, 2 * SIZE, steps)
    assert tally.unfinished == 2 * SIZE
    assert tally.worst_unbalance == worst > 1e-8
    assert 0 < tally.worst_overlap < 0.1
    tally.clear()
    assert (tally.evaluations, tally.steps, tally.unfinished) == (0, 0, 0)


# Files


@pytest.mark.parametrize("operator_name", ["UKO", "CTO"])
def test_a_saved_law_comes_back_bit_for_bit_and_goes_on_with_the_same_bits(
    packing, tmp_path, operator_name
):
    law = walked(packing, operator_name)
    again = HomogenisedLaw(packing, SIZE, FAST, operator_name)
    again.evaluate(increments(20))  # a trial of its own, to be forgotten
    with h5py.File(tmp_path / "law.h5", "w") as file:
        law.save(file.create_group("law"))
    with h5py.File(tmp_path / "law.h5", "r") as file:
        again.load(file["law"])
    for name in ("stress", "deformation", "deviatoric_strain", "void_ratio",
                 "coordination_number", "fabric_anisotropy", "failed"):  # fmt: skip
        np.testing.assert_array_equal(getattr(again, name), getattr(law, name), err_msg=name)
    for seed in (11, 12):
        np.testing.assert_array_equal(
            again.evaluate(increments(seed)), law.evaluate(increments(seed))
        )
        np.testing.assert_array_equal(again.tangent(), law.tangent())
        law.commit()
        again.commit()


def test_what_an_operator_learns_from_a_trial_is_not_saved(packing, tmp_path):
    laws = [walked(packing, "PSTLO-secant") for _ in range(2)]
    for law in laws:
        law.evaluate(increments(2))
        law.tangent()
        law.commit()
    law, other = laws
    law.evaluate(np.eye(2) + 5 * (increments(3) - np.eye(2)))
    law.tangent()  # far enough to be computed anew
    again = HomogenisedLaw(packing, SIZE, FAST, "PSTLO-secant")
    with h5py.File(tmp_path / "law.h5", "w") as file:
        law.save(file)
        again.load(file)
    answers = []
    for one in (again, other, law):
        one.discard()
        one.evaluate(increments(4))
        answers.append(one.tangent())
    np.testing.assert_array_equal(answers[0], answers[1])
    assert not np.array_equal(answers[0], answers[2])


def test_a_law_goes_on_with_another_operator_than_the_one_it_was_saved_with(packing, tmp_path):
    for first, second in (("UKO", "PSTLO-secant"), ("PSTLO-secant", "UKO")):
        law = walked(packing, first)
        law.tangent()
        law.commit()
        again = HomogenisedLaw(packing, SIZE, FAST, second)
        with h5py.File(tmp_path / f"{first}.h5", "w") as file:
            law.save(file)
            again.load(file)
        np.testing.assert_array_equal(again.evaluate(increments(4)), law.evaluate(increments(4)))
        assert np.isfinite(again.tangent()).all()


def test_a_trial_is_not_saved(packing, tmp_path):
    law = walked(packing)
    committed = law.stress.copy()
    law.evaluate(increments(9))
    again = HomogenisedLaw(packing, SIZE, FAST)
    with h5py.File(tmp_path / "law.h5", "w") as file:
        law.save(file.create_group("law"))
        again.load(file["law"])
    np.testing.assert_array_equal(again.stress, committed)


def test_a_state_of_another_size_is_refused_and_changes_nothing(packing, tmp_path):
    law, other = walked(packing), HomogenisedLaw(packing, SIZE + 1, FAST)
    before = other.stress.copy()
    with h5py.File(tmp_path / "law.h5", "w") as file:
        law.save(file.create_group("law"))
        with pytest.raises(ValueError, match="shape") as error:
            other.load(file["law"])
    assert str(tmp_path / "law.h5") in str(error.value)
    np.testing.assert_array_equal(other.stress, before)


# Packings that lose all contacts (Guo-Zhao section 4.2)


@pytest.fixture(scope="module")
def pulled_apart(packing):
    """Point 0 pulled apart in five steps, point 1 sheared; UKO."""
    law = HomogenisedLaw(packing, 2, FAST)
    law.evaluate(np.broadcast_to(np.eye(2), (2, 2, 2)))
    law.tangent()
    for _ in range(5):
        law.evaluate(np.array([1.01 * np.eye(2), np.diag([1.0004, 0.9995])]))
        law.commit()
    return law


def test_a_packing_pulled_apart_has_no_stress_and_says_so(pulled_apart):
    assert (pulled_apart.stress[0] == 0).all()
    assert pulled_apart.failed.tolist() == [True, False]
    assert pulled_apart.coordination_number[0] == 0
    assert pulled_apart.fabric_anisotropy[0] == 0
    assert pulled_apart.response.committed_outcome.at_rest.all()
    for name in ("stress", "void_ratio", "deviatoric_strain", "fabric_anisotropy"):
        assert np.isfinite(getattr(pulled_apart, name)).all()
    assert len(pulled_apart.packing(0).contacts) == 0


def test_its_tangent_keeps_the_global_matrix_solvable(pulled_apart):
    C = pulled_apart.tangent()
    assert np.isfinite(C).all()
    matrices = C.reshape(2, 4, 4)
    eigenvalues = np.linalg.eigvalsh(0.5 * (matrices + matrices.transpose(0, 2, 1)))
    assert (eigenvalues > 0).all()
    assert eigenvalues[0].max() < 0.1 * eigenvalues[1].max()  # and carries next to nothing


def test_it_regains_contact_and_stress_when_pushed_together(pulled_apart, tmp_path):
    law = HomogenisedLaw(reference_packing(), 2, FAST)
    with h5py.File(tmp_path / "law.h5", "w") as file:
        pulled_apart.save(file.create_group("law"))
        law.load(file["law"])
    for _ in range(6):
        law.evaluate(np.array([np.eye(2) / 1.01, np.eye(2)]))
        law.commit()
    assert not law.failed.any()
    assert (np.linalg.eigvalsh(law.stress[0]) < -1e3).all()
    assert law.coordination_number[0] > 2


def test_cto_of_a_packing_pulled_apart_is_solvable_too(packing):
    law = HomogenisedLaw(packing, 1, FAST, "CTO")
    law.evaluate(np.eye(2)[None])
    law.tangent()
    law.evaluate(1.03 * np.eye(2)[None])
    C = law.tangent()[0].reshape(4, 4)
    assert np.linalg.eigvalsh(0.5 * (C + C.T)).min() > 0
