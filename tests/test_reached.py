"""What a run tells of its micro scale, and when it warns."""

from dataclasses import replace

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from femxdem_fenicsx.reached import Reached
from tests.reference import reference_packing

FAST = PRESETS["fast"]


@pytest.fixture(scope="module")
def calm() -> Reached:
    law = HomogenisedLaw(reference_packing(), 2, FAST)
    law.evaluate(np.array([np.eye(2), np.diag([1.0008, 0.999])]))
    return Reached.by(law)


def test_a_calm_run_reaches_what_was_asked_for_and_warns_of_nothing(calm):
    assert calm.holds_at_limit == 0
    assert 0 < calm.unbalance < FAST.tolerance
    assert calm.inertial_number == pytest.approx(FAST.inertial_number, rel=0.2)
    assert 0 < calm.overlap < 0.05
    assert calm.warning == ""
    assert len(calm.table) == 3


@pytest.mark.parametrize(
    ("worse", "told"),
    [
        ({"holds_at_limit": 0.034, "unbalance": 0.2}, "3.4% of the holds ended at their limit of"),
        ({"inertial_number": 0.2}, "an inertial number of 2.0e-01 was reached where 5.0e-03 was"),
        ({"overlap": 0.17}, "grains overlapped by up to 17% of their diameter"),
    ],
)
def test_each_assumption_that_is_violated_is_told_in_the_one_warning_line(calm, worse, told):
    warning = replace(calm, **worse).warning
    assert warning.startswith("warning: less accurate than asked for: ") and "\n" not in warning
    assert told in warning


def test_all_that_is_violated_is_told_at_once_and_the_table_has_the_numbers(calm):
    bad = replace(calm, holds_at_limit=0.034, unbalance=0.2, inertial_number=0.3, overlap=0.17)
    holds, faster, overlap = bad.warning.split("; ")
    assert holds.startswith("warning: less accurate than asked for: 3.4% of the holds ended at")
    assert faster.startswith("an inertial number of 3.0e-01 was reached")
    assert overlap.startswith("grains overlapped by up to 17%")
    assert bad.table == {
        "holds that ended at their limit": "3.4%",
        "worst unbalance, largest overlap": "2.0e-01, 1.7e-01",
        "largest inertial number": "3.0e-01",
    }


def test_packings_that_lose_their_pressure_are_faster_than_asked_for():
    law = HomogenisedLaw(reference_packing(), 1, FAST)
    for F in [1.002 * np.eye(2)] * 4 + [np.eye(2) / 1.002] * 4:
        law.evaluate(F[None])
        law.commit()
    assert "packings lost their pressure" in Reached.by(law).warning


def test_ranks_add_up_their_holds_and_compare_the_rest():
    law = HomogenisedLaw(reference_packing(), 1, FAST.but(hold_limit=25, tolerance=1e-9))
    law.evaluate(np.diag([1.0008, 0.999])[None])
    alone = Reached.by(law)
    together = Reached.by(law, lambda x: 2 * x, lambda x: max(x, 0.5))
    assert alone.holds_at_limit == together.holds_at_limit == 1.0
    assert together.unbalance == together.inertial_number == together.overlap == 0.5
