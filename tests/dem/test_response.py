"""A batch of packings: trial and committed state, threads, errors."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.homogenisation import fabric, stress, touching
from femxdem_fenicsx.dem.packing import PackingBatch
from femxdem_fenicsx.dem.response import Response
from tests.reference import reference_packing

from .scenes import hexagonal

BALANCED = PRESETS["balanced"]
SIZE = 5


@pytest.fixture(scope="module")
def packing():
    return reference_packing()


def increments(seed: int, amplitude: float = 2e-3) -> np.ndarray:
    return np.eye(2) + amplitude * np.random.default_rng(seed).uniform(-1, 1, (SIZE, 2, 2))


def assert_same_state(one: PackingBatch, other: PackingBatch):
    for b in range(one.size):
        for name in ("box", "position", "flow", "flow_gradient", "row"):
            np.testing.assert_array_equal(getattr(one, name)[b], getattr(other, name)[b])
        count = one.row[b, -1]
        for name in ("second", "tangential"):
            np.testing.assert_array_equal(
                getattr(one, name)[b, ..., :count], getattr(other, name)[b, ..., :count]
            )


def test_the_first_outcome_is_that_of_the_packing_itself(packing):
    response = Response(packing, SIZE, BALANCED)
    outcome = response.committed_outcome
    for b in range(SIZE):
        np.testing.assert_array_equal(outcome.stress[b], stress(packing))
        np.testing.assert_array_equal(outcome.fabric[b], fabric(touching(packing)))
    assert (outcome.contacts == 832).all()
    assert outcome.at_rest.all()


def test_deform_is_a_function_of_F_alone_in_any_order_of_calls(packing):
    response = Response(packing, SIZE, BALANCED)
    response.deform(increments(0))
    response.commit()
    first = response.deform(increments(1)).stress.copy()
    response.deform(increments(2, 2e-2))
    response.probe(increments(3), np.arange(SIZE))
    response.discard()
    shuffled = np.array([3, 1, 4, 0, 2])
    probed = response.probe(increments(1)[shuffled], shuffled).stress
    np.testing.assert_array_equal(probed, first[shuffled])
    np.testing.assert_array_equal(response.deform(increments(1)).stress, first)


def test_a_packing_answers_the_same_alone_and_among_others(packing):
    among = Response(packing, SIZE, BALANCED)
    alone = Response(packing, 1, BALANCED)
    for seed in (1, 2):
        F = increments(seed)
        F[4] = np.diag([1.12, 0.95])  # a neighbour far off must not matter
        everyone = among.deform(F).stress[2].copy()
        np.testing.assert_array_equal(alone.deform(F[2:3]).stress[0], everyone)
        among.commit()
        alone.commit()


def test_threads_change_no_bit(packing):
    one, two = (Response(packing, SIZE, BALANCED, threads) for threads in (1, 2))
    for seed in range(3):
        a, b = one.deform(increments(seed)), two.deform(increments(seed))
        for name, value in a._asdict().items():
            np.testing.assert_array_equal(value, getattr(b, name), err_msg=name)
        one.commit()
        two.commit()
        assert_same_state(one.committed, two.committed)


def test_discard_and_a_commit_without_a_trial_change_nothing(packing):
    response = Response(packing, SIZE, BALANCED)
    response.deform(increments(1))
    response.commit()
    before, kept = response.committed.copy(), response.committed_outcome.stress.copy()
    response.deform(increments(2))
    response.discard()
    response.commit()
    response.commit()
    assert_same_state(before, response.committed)
    np.testing.assert_array_equal(response.committed_outcome.stress, kept)
    assert response.latest is response.committed


def test_the_last_trial_is_committed_and_no_earlier_one(packing):
    response, other = (Response(packing, SIZE, BALANCED) for _ in range(2))
    response.deform(increments(1))
    response.deform(increments(2))
    response.commit()
    other.deform(increments(2))
    other.commit()
    assert_same_state(response.committed, other.committed)


def test_a_probe_leaves_the_trial_state_as_it_is(packing):
    response = Response(packing, SIZE, BALANCED)
    response.deform(increments(1))
    trial = response.trial.copy()
    outcome = response.probe(increments(2)[:2], np.array([4, 0]))
    assert len(outcome.stress) == 2
    assert response.latest is response.trial
    assert_same_state(trial, response.trial)


def test_the_committed_box_is_F_times_the_old_one_to_the_last_bit(packing):
    response = Response(packing, SIZE, BALANCED)
    F = increments(5, 1e-2)
    response.deform(F)
    response.commit()
    np.testing.assert_allclose(response.committed.box, F @ packing.box, rtol=1e-15, atol=1e-18)


def test_work_space_grows_with_the_pairs_of_a_dense_packing():
    loose, F = hexagonal(overlap=-0.01), 0.8 * np.eye(2)[None]
    response = Response(loose, 1, PRESETS["fast"])
    first_capacity = response._capacity
    response._capacity = first_capacity = 2 * loose.size
    outcome = response.deform(F)
    assert outcome.contacts[0] > first_capacity
    roomy = Response(loose, 1, PRESETS["fast"])
    roomy._capacity = 8 * first_capacity
    np.testing.assert_array_equal(roomy.deform(F).stress, outcome.stress)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("grains, why", [(10, "its own image"), (20, "of the grains' volume")])
def test_a_box_without_room_for_its_grains_is_named_and_the_others_go_on(threads, grains, why):
    response = Response(hexagonal(grains, grains), SIZE, PRESETS["fast"], threads)
    expected = response.deform(increments(1)).stress.copy()
    bad = increments(1)
    bad[3] *= 0.2
    with pytest.raises(ValueError, match=f"packing 3.*{why}") as error:
        response.deform(bad)
    assert "\n" not in str(error.value)
    np.testing.assert_array_equal(response.deform(increments(1)).stress, expected)


@pytest.mark.parametrize("threads", [1, 2])
def test_grains_that_collapse_are_named_and_the_others_go_on_afterwards(threads, monkeypatch):
    monkeypatch.setattr("femxdem_fenicsx.dem.response.MOST_PAIRS_PER_GRAIN", 0.1)
    response = Response(hexagonal(10, 10), SIZE, PRESETS["fast"], threads)
    expected = response.deform(increments(1)).stress.copy()
    response._capacity = 10
    response._spaces.clear()
    with pytest.raises(FloatingPointError, match=r"packing .: its grains have collapsed"):
        response.deform(increments(1))
    response._capacity = 1000
    np.testing.assert_array_equal(response.deform(increments(1)).stress, expected)


def test_an_error_leaves_the_committed_state_alone(packing):
    response = Response(packing, SIZE, BALANCED)
    before = response.committed.copy()
    bad = increments(1)
    bad[4, 0, 0] = np.nan
    with pytest.raises(ValueError, match="deformation gradient 4"):
        response.deform(bad)
    assert_same_state(before, response.committed)


def test_sizes_and_threads_that_do_not_exist_are_refused(packing):
    with pytest.raises(ValueError, match="size"):
        Response(packing, -1, BALANCED)
    with pytest.raises(ValueError, match="threads"):
        Response(packing, 1, BALANCED, 0)


def test_a_rank_without_points_has_nothing_to_do(packing):
    response = Response(packing, 0, BALANCED)
    assert response.deform(np.zeros((0, 2, 2))).stress.shape == (0, 2, 2)
    response.commit()


def test_contacts_too_soft_for_their_pressure_are_warned_of_with_the_overlap():
    with pytest.warns(UserWarning, match="overlap by up to 15%"):
        Response(hexagonal(overlap=0.15), 1, BALANCED)


def test_a_packing_of_grains_inside_each_other_is_refused():
    with pytest.raises(ValueError, match="overlap by up to 60% of their diameter"):
        Response(hexagonal(12, 12, overlap=0.6), 1, BALANCED)
