"""The critical state at constant volume: packings in one batch, means and errors of means."""

import numpy as np
import pytest

from femxdem_fenicsx import critical_state as module
from femxdem_fenicsx.critical_state import Critical, Shear, batch, critical_state
from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.preparation import library
from femxdem_fenicsx.homogenised_law import HomogenisedLaw

FAST = PRESETS["fast"]


@pytest.fixture(scope="module")
def packings():
    return list(library(4, grains=100))


def test_a_batch_answers_as_each_packing_on_its_own(packings):
    """But for the time step, which is that of the first one."""
    F = np.array([[1.0, 1e-3], [0.0, 1.0]])
    together = batch(packings, FAST).evaluate(np.tile(F, (len(packings), 1, 1)))
    alone = [HomogenisedLaw(packing, 1, FAST).evaluate(F[None])[0] for packing in packings]
    np.testing.assert_array_equal(together[0], alone[0])
    np.testing.assert_allclose(together, alone, atol=2e3)  # of 1e5 Pa


def test_all_packings_are_brought_to_the_void_ratio_while_sheared_and_keep_it(
    packings, monkeypatch
):
    made = []
    monkeypatch.setattr(module, "batch", lambda *args: made.append(batch(*args)) or made[-1])
    critical_state(packings, FAST, Shear(0.2, first=8e-3, last=1e-2))
    (law,) = made
    volume = np.linalg.det(law.deformation) * (1 + np.array([p.void_ratio for p in packings]))
    np.testing.assert_allclose(volume, 1.2, rtol=1e-6)
    shear = law.deformation[:, 0, 1] / law.deformation[:, 1, 1]
    np.testing.assert_allclose(shear, 1e-2, rtol=1e-5)


def test_dense_disks_bear_pressure_and_mobilise_friction_of_disks_without_rolling(packings):
    found = critical_state(packings, FAST, Shear(0.2, first=0.15, last=0.25))
    assert found.pressure.shape == found.friction_angle.shape == (4,)
    assert (found.pressure > 0).all()
    angle, _ = found.mean("friction_angle")
    assert 10 < angle < 28.65  # less than the 0.5 of their contacts, and what disks have
    assert found.steps > 25  # the shortest hold


def test_a_smaller_void_ratio_bears_more_pressure(packings):
    dense, loose = (
        critical_state(packings, FAST, Shear(ratio, first=0.1, last=0.2)).mean("pressure")[0]
        for ratio in (0.17, 0.22)
    )
    assert dense > 2 * loose


def test_a_slower_rate_takes_more_steps_which_are_those_of_what_is_averaged(packings):
    path = Shear(packings[0].void_ratio, first=2e-3, last=5e-3)
    fast, reference = (
        critical_state(packings[:2], PRESETS[name], path).steps for name in ("fast", "reference")
    )
    assert 25 < 3 * fast < reference < 5000


def test_a_mean_has_the_standard_error_of_independent_packings():
    values = np.random.default_rng(0).normal(1e5, 1e4, 400)
    mean, error = Critical(values, values, 1.0).mean("pressure")
    assert mean == values.mean() and error == pytest.approx(1e4 / 20, rel=0.1)


def test_a_row_is_off_the_reference_by_both_errors():
    theirs = Critical(np.array([0.9e5, 1.1e5]), np.array([17.0, 18.0]), 800.0)
    ours = Critical(np.array([1.1e5, 1.3e5]), np.array([17.0, 19.0]), 40.0)
    row = module.row("fast", FAST, ours, theirs)
    assert (row["accuracy"], row["packings"], row["dem_steps"]) == ("fast", 2, 40.0)
    assert row["pressure_error"] == pytest.approx(0.2)
    assert row["pressure_error_standard_error"] == pytest.approx(0.1 * np.sqrt(2))
    assert row["friction_angle_deg"] == 18.0
    same = module.row("reference", FAST, theirs, theirs)
    assert same["pressure_error"] == same["pressure_error_standard_error"] == 0.0


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"step": 0.2}, "step in"),
        ({"first": 0.5, "last": 0.5}, "first < last"),
        ({"void_ratio": 0.0}, "positive void ratio"),
        ({"void_ratio": np.nan}, "positive void ratio"),
    ],
)
def test_shear_that_cannot_be_is_refused(values, complaint):
    with pytest.raises(ValueError, match=f"critical state: .*{complaint}"):
        Shear(**values)


def test_the_void_ratio_of_a_drained_test_is_looser_than_a_dense_packing(packings):
    found = module.critical_void_ratio(packings[0], Shear(first=0.1, last=0.2, step=2e-3))
    assert packings[0].void_ratio < found < 0.3
