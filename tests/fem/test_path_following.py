"""Snap-back: a bar of three elements of which one softens, solved in closed form.

Poisson's ratio is zero, so that the bar is in uniaxial strain. Behind the peak the weak element
has the stress E k0 x at the strain k0 (1 - ln x), x falling from 1 (`law.Softening`); the two
strong ones unload elastically to k0 x. The plates are u = h k0 (2 x + 1 - ln x) nearer: u falls
together with x down to x = 1/2. Prescribing u, there is no equilibrium near the peak; the next one
at the same u has 2 x - ln x = 2.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

from femxdem_fenicsx.collective import Interrupted
from femxdem_fenicsx.fem.path_following import Crossing, cross
from femxdem_fenicsx.fem.stepping import LoadStepping, walk
from tests.fem.snap_back import K0, PEAK, E, bar, resumed
from tests.fem.specimen import HEIGHT, WIDTH

LANDING = brentq(lambda x: 2 * x - np.log(x) - 2, 1e-3, 0.9)


def compressed(end: float, crossing: Crossing | None, **sizes):
    specimen, records = bar(), []
    stepping = LoadStepping(0.13 * K0, 0.13 * K0, looser_limit=0.0, crossing=crossing, **sizes)
    outcome = walk(specimen.problem, specimen.compress, end, stepping, records.append)
    return specimen, outcome, records


def stress_share(strain: float) -> float:
    """x behind the jump at that axial strain of the bar."""
    return brentq(lambda x: 2 * x + 1 - np.log(x) - 3 * strain / K0, 1e-6, 0.5)


def test_without_path_following_the_path_ends_at_the_peak():
    _, outcome, records = compressed(1.5 * PEAK, None)
    assert "lost controllability" in outcome.lost_controllability
    assert PEAK - 0.13 * K0 < outcome.load <= PEAK
    assert outcome.crossings == outcome.moves == 0
    assert all(record.converged for record in records)


def test_the_specimen_crosses_to_the_next_equilibrium_and_follows_it():
    specimen, outcome, records = compressed(1.5 * PEAK, Crossing())
    assert outcome.load == 1.5 * PEAK and not outcome.lost_controllability
    assert outcome.crossings == 1 and outcome.not_converged == 0
    jump = next(i for i, record in enumerate(records) if record.moves)
    assert records[jump - 1].load <= PEAK < records[jump].load
    assert all(record.residual <= 1e-6 for record in records)
    force = -specimen.top_force() / WIDTH / E / K0
    assert force == pytest.approx(stress_share(1.5 * PEAK), rel=5e-3)
    assert force < LANDING


def test_the_lost_work_is_what_the_closed_form_leaves_over():
    """The plates' and what the strong elements release, less what the weak one dissipates."""
    x = stress_share(1.01 * PEAK)
    released = E * K0**2 * WIDTH * HEIGHT / 3 * ((1 - x**2) - (1 - x))
    lost = []
    for time in (1.0, 0.3):
        specimen = bar()
        steps = LoadStepping(PEAK / 2)
        walk(specimen.problem, specimen.compress, PEAK * (1 - 1e-9), steps)
        specimen.compress(PEAK, 1.01 * PEAK)
        settings = Crossing(time, time, most_moves=2000)
        hold = lambda specimen=specimen: specimen.compress(0.0, 0.0)  # noqa: E731
        crossed = cross(specimen.problem, 0.01 * PEAK, hold, 1e-6, settings)
        assert crossed.reason == "" and crossed.residual <= 1e-6
        assert -specimen.top_force() / WIDTH / E / K0 == pytest.approx(x, rel=5e-3)
        lost.append(crossed.lost_work / (released + crossed.work) - 1)
    assert lost == pytest.approx([0.0, 0.0], abs=0.01)


def test_the_work_of_the_reactions_is_the_area_below_the_curve():
    _, outcome, records = compressed(0.9 * PEAK, None)
    area = 0.5 * E * 0.9**2 * PEAK**2 * WIDTH * HEIGHT
    assert outcome.work == records[-1].work == pytest.approx(area, rel=2e-3)
    assert outcome.lost_work < 1e-6 * outcome.work


def test_a_motion_that_does_not_come_to_rest_ends_the_path_and_says_so():
    _, outcome, records = compressed(1.5 * PEAK, Crossing(most_moves=2))
    assert "after 2 moves" in outcome.lost_controllability
    assert "not at rest" in outcome.lost_controllability
    assert outcome.load == records[-1].load <= PEAK


def test_a_run_that_is_asked_to_stop_stops_behind_the_crossing():
    """What a crossing has committed cannot be taken back."""
    specimen, records = bar(), []
    moving, cross_over = [], specimen.problem.stiffness

    def asked() -> bool:
        return bool(moving)

    def stiffness():
        moving.append(True)
        return cross_over()

    specimen.problem.stiffness = stiffness
    specimen.operator.interrupted = asked
    stepping = LoadStepping(0.13 * K0, 0.13 * K0, looser_limit=0.0, crossing=Crossing())
    outcome = walk(specimen.problem, specimen.compress, 1.5 * PEAK, stepping, records.append)
    assert outcome.interrupted and outcome.crossings == 1
    assert outcome.load == records[-1].load and records[-1].moves > 0
    with pytest.raises(Interrupted):
        specimen.operator.evaluate()


def test_a_run_that_goes_on_from_behind_a_crossing_gives_the_same_bits(tmp_path):
    stepping = LoadStepping(0.13 * K0, 0.13 * K0, looser_limit=0.0, crossing=Crossing())
    _, one, two, *bars = resumed(
        tmp_path, 1.5 * PEAK, stepping, lambda position: position.crossings > 0
    )
    assert one == two and one.crossings == 1
    assert bars[0].top_force() == bars[1].top_force()
