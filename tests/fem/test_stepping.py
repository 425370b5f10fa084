"""Load paths: cut steps, best iterates, lost controllability."""

import numpy as np
import pytest

from femxdem_fenicsx.fem.stepping import LoadStepping, walk
from femxdem_fenicsx.law import LinearElastic, NeoHookean, Softening
from tests.fem.laws import Fragile, Noisy
from tests.fem.specimen import WIDTH, Specimen

E, NU = 100.0, 0.3


def test_steps_reach_the_end_exactly_and_the_last_is_what_is_left():
    specimen = Specimen(lambda points: LinearElastic(points.size, E, NU), formulation="small")
    records, ends = [], []

    def load(start, end):
        ends.append((start, end))
        specimen.compress(start, end)

    outcome = walk(specimen.problem, load, 0.01, LoadStepping(0.003), records.append)
    assert outcome.load == records[-1].load == ends[-1][1] == 0.01
    assert [r.step for r in records] == pytest.approx([0.003, 0.003, 0.003, 0.001])
    assert [start for start, _ in ends] == [0.0] + [r.load for r in records[:-1]]
    assert outcome.steps == 4 and outcome.cuts == 0 and not outcome.lost_controllability
    assert outcome.evaluations == sum(r.evaluations for r in records)


def test_a_step_too_large_for_the_law_is_halved_and_grows_again():
    def path(law):
        specimen, records = Specimen(law, distortion=0.0), []
        outcome = walk(
            specimen.problem, specimen.compress, 0.1, LoadStepping(0.04, 0.005), records.append
        )
        return specimen, outcome, records

    specimen, outcome, records = path(lambda points: Fragile(points.size, 0.03))
    smooth, *_ = path(lambda points: NeoHookean(points.size, E, NU))
    assert outcome.load == 0.1 and outcome.cuts >= 1 and outcome.not_converged == 0
    assert records[0].step == 0.02 and records[0].cuts == 1
    assert max(record.cuts for record in records) == outcome.cuts >= 2  # it tried 0.04 again
    assert specimen.top_force() == pytest.approx(smooth.top_force(), rel=1e-8)


def test_where_nothing_converges_the_best_iterate_is_accepted_counted_and_carried_on():
    specimen = Specimen(
        lambda points: Noisy(points.size, 0.015),
        formulation="small",
        rough=True,
        tolerance=5e-3,
        max_iterations=6,
    )
    records = []
    outcome = walk(
        specimen.problem, specimen.compress, 0.01, LoadStepping(0.002, 0.001), records.append
    )
    assert outcome.load == 0.01 and not outcome.lost_controllability
    assert outcome.not_converged == sum(not r.converged for r in records) > 0
    assert all(5e-3 < r.residual <= 5e-2 for r in records if not r.converged)
    assert all(r.residual <= 5e-3 for r in records if r.converged)


def test_a_load_beyond_the_peak_ends_the_path_there_and_says_so():
    specimen = Specimen(
        lambda points: Softening(points.size, E, NU, threshold=0.02),
        formulation="small",
        cells=(1, 2),
        axial_load=True,
        tolerance=1e-8,
        max_iterations=10,
    )

    def load(start, end):
        specimen.axial.value = end

    stepping = LoadStepping(0.3, smallest=0.01, looser_limit=0.0)
    outcome = walk(specimen.problem, load, 10.0, stepping)
    # elastic up to the peak: strains (-(1 - nu^2), nu (1 + nu)) p / E, on the moving geometry
    norm = np.hypot(1 - NU**2, NU * (1 + NU))
    peak = 0.02 * E / norm
    assert peak - 0.05 < outcome.load < peak + 0.05
    assert outcome.cuts == 5
    assert f"lost controllability at load {outcome.load:.6g}" in outcome.lost_controllability
    # the state is that of the last step: balanced, and nothing of the failed trial in it
    stress = specimen.committed_stress()
    assert stress[:, 1, 1] == pytest.approx(-outcome.load, rel=1e-6)
    assert not specimen.u.x.array.any()


def test_a_path_can_go_on_from_where_another_ended():
    def force(*ends):
        specimen = Specimen(lambda points: NeoHookean(points.size, E, NU))
        start = 0.0
        for end in ends:
            walk(specimen.problem, specimen.compress, end, LoadStepping(0.02), start=start)
            start = end
        return specimen.top_force()

    assert force(0.04, 0.08) == pytest.approx(force(0.08), rel=1e-12)
    assert abs(force(0.08)) > WIDTH


@pytest.mark.parametrize(
    "arguments",
    [
        {"step": 0.0},
        {"step": np.nan},
        {"step": 1.0, "smallest": 2.0},
        {"step": 1.0, "grow_after": 0},
        {"step": 1.0, "looser_limit": -1.0},
        {"step": 1.0, "looser_limit": np.nan},
    ],
)
def test_step_sizes_out_of_order_are_refused(arguments):
    with pytest.raises(ValueError, match="sizes must be positive"):
        LoadStepping(**arguments)


def test_a_path_must_lead_somewhere():
    with pytest.raises(ValueError, match="the end must be above the start"):
        walk(None, None, 0.0, LoadStepping(0.1))
