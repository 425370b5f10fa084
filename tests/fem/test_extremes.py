"""The macro scale at its extremes: what works there, and what stops with a line that says why.

docs/stability.md has the table.
"""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.fem.convergence import Convergence
from femxdem_fenicsx.fem.stepping import LoadStepping, walk
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from femxdem_fenicsx.law import NeoHookean
from tests.fem.laws import Fragile
from tests.fem.specimen import HEIGHT, Specimen
from tests.reference import reference_packing

E, NU = 100.0, 0.3


def elastic(**options) -> Specimen:
    return Specimen(lambda points: NeoHookean(points.size, E, NU), **options)


def path(specimen: Specimen, end: float, stepping: LoadStepping):
    records = []
    return walk(specimen.problem, specimen.compress, end, stepping, records.append), records


# Newton's tolerance


def test_a_tolerance_of_zero_is_refused():
    with pytest.raises(ValueError, match=r"convergence by force 0.*give positive limits"):
        Convergence(force=0.0)


def test_a_tolerance_that_nothing_meets_ends_as_counted_steps_under_the_looser_limit():
    specimen = elastic(tolerance=1e-300, max_iterations=6, cells=(1, 2))
    outcome, records = path(specimen, 0.02, LoadStepping(0.01, 0.005, looser_limit=1e-6))
    assert outcome.load == 0.02
    assert outcome.not_converged == outcome.steps == 4  # every step is cut once
    assert all(not r.converged and r.residual < 1e-10 for r in records)
    assert specimen.top_force() == pytest.approx(_force_of_a_good_solution(), rel=1e-8)


def test_without_a_looser_limit_the_path_ends_there_and_the_state_is_the_last_good_one():
    specimen = elastic(tolerance=1e-300, max_iterations=6, cells=(1, 2))
    outcome, records = path(specimen, 0.02, LoadStepping(0.01, 0.005, looser_limit=0.0))
    assert (outcome.load, outcome.steps, records) == (0.0, 0, [])
    assert "lost controllability at load 0: a step of 0.005 ends" in outcome.lost_controllability
    assert not specimen.u.x.array.any()
    assert specimen.volume() == pytest.approx(HEIGHT)


def test_a_tolerance_of_one_accepts_the_first_guess_and_tells_its_residual():
    specimen = elastic(tolerance=1.0, cells=(1, 2))
    outcome, records = path(specimen, 0.02, LoadStepping(0.01))
    assert outcome.load == 0.02 and outcome.not_converged == 0
    assert all(0 <= r.residual <= 1 and r.iterations <= 1 for r in records)
    assert np.isfinite(specimen.top_force())


def _force_of_a_good_solution() -> float:
    specimen = elastic(cells=(1, 2))
    path(specimen, 0.02, LoadStepping(0.005))
    return specimen.top_force()


# Steps


class FragileAtFirst(Fragile):
    """Follows small increments only, until it has been committed twice."""

    commits = 0

    def commit(self) -> None:
        super().commit()
        self.commits += 1
        if self.commits == 2:
            self._limit = np.inf


def test_a_step_that_must_be_cut_ten_times_is_found_and_grows_again():
    step = 0.08
    specimen = Specimen(
        lambda points: FragileAtFirst(points.size, 1.5 * step / 1024), cells=(1, 1), name="Q4",
        distortion=0.0,
    )  # fmt: skip
    outcome, records = path(specimen, step, LoadStepping(step, step / 4096, grow_after=1))
    assert outcome.load == step and outcome.not_converged == 0
    assert records[0].cuts == 10 and records[0].step == step / 1024
    assert max(r.step for r in records) >= step / 8
    smooth = elastic(cells=(1, 1), name="Q4", distortion=0.0)
    path(smooth, step, LoadStepping(step / 8))
    assert specimen.top_force() == pytest.approx(smooth.top_force(), rel=1e-6)


# Meshes


@pytest.mark.parametrize("cells", [(1, 1), (400, 1), (1, 200)])
@pytest.mark.parametrize("name", ["Q4", "Q8"])
def test_one_element_and_needles_give_the_uniform_solution(name, cells):
    """Needles of 2 m x 2.5 mm and 1 m x 10 mm; smooth plates, hence sigma_xx = 0."""
    specimen = elastic(name=name, cells=cells, distortion=0.0)
    outcome, _ = path(specimen, 0.01, LoadStepping(0.01))
    assert outcome.load == 0.01 and outcome.not_converged == 0
    stress = specimen.committed_stress()
    np.testing.assert_allclose(stress[:, 1, 1], stress[0, 1, 1], rtol=1e-8)
    np.testing.assert_allclose(stress[:, 0, 0], 0.0, atol=1e-8 * E)
    assert stress[0, 1, 1] == pytest.approx(-0.01 * E / (1 - NU**2), rel=3e-2)


# Grains


@pytest.fixture
def failed() -> Specimen:
    """One element whose four packings have been pulled apart: no contact, no stress."""
    specimen = Specimen(
        lambda points: HomogenisedLaw(reference_packing(), points.size, PRESETS["fast"]),
        cells=(1, 1), name="Q4", distortion=0.0, tolerance=1e-2, max_iterations=10,
    )  # fmt: skip
    for _ in range(5):
        specimen.law.evaluate(np.tile(1.01 * np.eye(2), (4, 1, 1)))
        specimen.law.commit()
    assert specimen.law.failed.all()
    return specimen


def test_a_specimen_whose_points_have_all_failed_moves_without_any_force(failed):
    outcome, _ = path(failed, 0.01, LoadStepping(0.005))
    assert outcome.load == 0.01 and outcome.not_converged == 0
    assert failed.law.failed.all()
    assert failed.top_force() == 0.0
    assert failed.volume() == pytest.approx(0.99 * HEIGHT, rel=1e-2)


def test_under_pressure_the_failed_specimen_finds_no_balance_and_says_so(failed):
    """The grains meet again on the way, but one step is too short to find the balance."""
    failed.pressure.value = 1e5
    outcome, records = path(failed, 0.01, LoadStepping(0.005, 0.0025, looser_limit=1e-2))
    told = outcome.lost_controllability
    assert "lost controllability at load 0" in told and "\n" not in told
    assert np.isfinite(failed.law.stress).all() and not records
