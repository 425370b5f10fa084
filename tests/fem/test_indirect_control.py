"""A bar that snaps back, followed in equilibrium; its closed form is in test_path_following.py."""

import numpy as np
import pytest

from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.indirect_control import IndirectControl, largest
from femxdem_fenicsx.fem.stepping import LoadStepping, walk
from femxdem_fenicsx.law import InadmissibleDeformation
from tests.fem.snap_back import K0, PEAK, E, bar, resumed
from tests.fem.specimen import WIDTH
from tests.petsc import petsc_options  # noqa: F401

STEPPING = LoadStepping(0.13 * K0, looser_limit=0.0, indirect=True)
#: The strain from which the plates go on, where the weak element has half its strength.
TURN = (2 + np.log(2)) / 3 * K0


def stress_of(specimen) -> float:
    """Over the peak's."""
    return -specimen.top_force() / WIDTH / E / K0


def followed(end: float, start=0.0, **settings):
    """Outcome, records and the stress behind each of them."""
    specimen, records, stresses = bar(), [], []

    def observe(record):
        records.append(record)
        stresses.append(stress_of(specimen))

    outcome = walk(specimen.problem, specimen.compress, end, STEPPING, observe, start, **settings)
    return outcome, records, np.array(stresses)


def closed_form(x: np.ndarray) -> np.ndarray:
    """Axial strain of the bar behind the peak, from its stress over the peak's."""
    return K0 * (2 * x + 1 - np.log(x)) / 3


def test_the_whole_snap_back_is_traced_in_equilibrium():
    outcome, records, x = followed(1.5 * PEAK)
    loads = np.array([record.load for record in records])
    assert outcome.load == 1.5 * PEAK and not outcome.lost_controllability
    assert outcome.not_converged == 0 and max(record.residual for record in records) <= 1e-6
    behind = int(x.argmax())  # the first step under indirect control leads over the peak
    assert loads[:behind] == pytest.approx(K0 * x[:behind], rel=1e-3)
    assert loads[behind:] == pytest.approx(closed_form(x[behind:]), rel=3e-4)
    assert (np.diff(x[behind:]) < 0).all()  # no piece of the branch is left out or gone twice
    assert np.abs(np.diff(x[behind:])).max() < 0.1
    assert loads[behind:].min() == pytest.approx(TURN, rel=1e-3)
    assert outcome.lost_work < 1e-6 * outcome.work


def test_the_load_leads_again_where_it_has_risen_above_the_place_where_it_was_lost():
    outcome, records, _ = followed(1.5 * PEAK)
    back = [i for i, record in enumerate(records) if record.step < 0]
    led = [record.load for record in records[back[-1] + outcome.controlled - len(back) :]]
    assert outcome.controlled > len(back) > 5 and outcome.control == 0.0
    assert led[0] > outcome.lost_at and np.allclose(np.diff(led[:3]), STEPPING.smallest, rtol=1)


def test_a_first_guess_that_goes_too_far_is_cut_as_an_iterate_would_be(monkeypatch):
    refused, make = [], ExternalOperator._check

    def check(operator, F):  # less than the steps that are tried
        far = np.abs(F - np.eye(2)).max()
        if far > 0.1 * K0:
            refused.append(far)
            raise InadmissibleDeformation("too far")
        make(operator, F)

    monkeypatch.setattr(ExternalOperator, "_check", check)
    outcome, _, x = followed(1.2 * PEAK)
    assert refused and outcome.load == 1.2 * PEAK and not outcome.lost_controllability
    assert outcome.load == pytest.approx(closed_form(x[-1]), rel=3e-4)


def test_newton_stays_on_the_branch_as_well(petsc_options):  # noqa: F811
    petsc_options("-femxdem_snes_type newtonls")
    outcome, _, x = followed(1.2 * PEAK)
    assert outcome.load == 1.2 * PEAK and outcome.not_converged == 0
    assert outcome.load == pytest.approx(closed_form(x[-1]), rel=3e-4)


def test_every_iterate_has_the_prescribed_strain_and_the_load_is_what_belongs_to_it():
    specimen = bar()
    problem = specimen.problem
    walk(problem, specimen.compress, 0.5 * PEAK, STEPPING)
    specimen.compress(0.5 * PEAK, 0.6 * PEAK)
    iterates = []
    problem.snes.setMonitor(lambda *_: iterates.append(problem.u.x.array.copy()))
    with IndirectControl(problem, 0.02 * K0):
        assert problem.solve(0.1 * PEAK).converged
    # uniaxial strain e, of the specimen before the peak: eps_q = sqrt(2) |dev| = |e|
    assert problem.balance.load_share() * 0.1 * PEAK == pytest.approx(0.02 * K0, rel=1e-4)
    assert [largest(problem, u) for u in iterates] == pytest.approx([0.02 * K0] * len(iterates))
    assert iterates


def test_a_run_that_goes_on_within_the_snap_back_gives_the_same_bits(tmp_path):
    within, one, two, *bars = resumed(
        tmp_path, 1.2 * PEAK, STEPPING, lambda position: position.controlled == 5
    )
    assert within.control > 0 and one == two
    assert bars[0].top_force() == bars[1].top_force()


def test_a_path_that_leads_back_to_its_start_ends_there_and_says_so():
    specimen = bar()
    walk(specimen.problem, specimen.compress, 0.97 * PEAK, STEPPING)
    outcome = walk(specimen.problem, specimen.compress, 1.5 * PEAK, STEPPING, start=0.97 * PEAK)
    assert outcome.load <= 0.97 * PEAK
    assert "led back to its start" in outcome.lost_controllability
