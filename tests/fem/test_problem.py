"""One load step: law evaluations, criteria, what is committed, PETSc options."""

import h5py
import numpy as np
import pytest
from petsc4py import PETSc

from femxdem_fenicsx.fem.convergence import Convergence
from femxdem_fenicsx.fem.options import petsc_options as pass_on
from femxdem_fenicsx.fem.problem import Problem
from femxdem_fenicsx.law import InadmissibleDeformation, LinearElastic, NeoHookean
from tests.fem.laws import Counting, Failing, Fragile, Noisy, NoStiffness, NoTangent, TooStiff
from tests.fem.specimen import Specimen


def counting(**options) -> Specimen:
    return Specimen(lambda points: Counting(points.size), rough=True, **options)


def test_each_iterate_is_evaluated_once_and_the_tangent_only_while_the_last_one_does_not_serve():
    specimen = counting()
    for step, from_zero in enumerate((1, 0)):  # only the first guess of the first step costs more
        specimen.compress(0.05 * step, 0.05 * (step + 1))
        before = specimen.law.evaluations, specimen.law.tangents
        solution = specimen.problem.solve()
        assert solution.evaluations == specimen.law.evaluations - before[0]
        assert solution.evaluations == solution.iterations + 1 + from_zero
        assert specimen.law.tangents - before[1] == 1 + from_zero  # at the first guess, at u = 0
        specimen.problem.accept()
        assert specimen.law.evaluations == before[0] + solution.evaluations
    assert specimen.operator.evaluations == specimen.law.evaluations


def test_the_jacobian_is_computed_anew_where_an_iteration_gains_too_little(petsc_options):
    tangents = {}
    for keep, slow in ((1, 0.7), (1, 1e-3), (0, 0.0)):
        petsc_options(f"-femxdem_snes_anderson_keep {keep} -femxdem_snes_anderson_slow {slow}")
        specimen = counting()
        for step in range(4):
            specimen.compress(0.05 * step, 0.05 * (step + 1))
            assert specimen.problem.solve().converged
            specimen.problem.accept()
        tangents[slow] = specimen.law.tangents
    assert tangents[0.7] == 2
    assert tangents[0.0] == 1 + 4
    assert tangents[1e-3] > 2


@pytest.mark.parametrize("forgets", [False, True])
def test_a_solver_that_forgets_computes_its_jacobian_anew(forgets, petsc_options):
    petsc_options("-femxdem_snes_anderson_keep 1")
    specimen = counting()
    for step in range(3):
        specimen.compress(0.05 * step, 0.05 * (step + 1))
        if forgets and step == 2:
            specimen.problem.forget()
        specimen.problem.solve()
        specimen.problem.accept()
    assert specimen.law.tangents == 2 + forgets


def test_the_first_guess_takes_away_what_the_last_step_left_out_of_balance():
    specimens = [counting(tolerance=tolerance) for tolerance in (1e-10, 0.3)]
    left = []
    for specimen in specimens:
        specimen.compress(0.0, 0.02)
        assert specimen.problem.solve().converged
        specimen.problem.accept()
        left.append(specimen.problem._left_over())
    assert np.linalg.norm(left[0]) < 1e-6 * np.linalg.norm(left[1])


def test_a_change_of_the_increment_that_goes_on_is_taken_along():
    specimen = counting(tolerance=1e-10)
    problem, guesses = specimen.problem, []
    guess = problem._first_guess
    problem._first_guess = lambda step: guesses.append(guess(step)) or guesses[-1].copy()
    for step in range(5):
        specimen.compress(0.02 * step, 0.02 * (step + 1))
        change, share = problem.forecast.change.copy(), problem.forecast.share
        assert problem.solve().converged
        end = problem.u.x.array[: problem.balance.size].copy()
        problem.accept()
    assert share >= 0.5 and not np.allclose(change, 0.0)
    off = np.linalg.norm(guesses[-1] - end)
    change[problem.balance.constrained] = 0.0  # prescribed, whatever the guess
    assert off < 0.5 * np.linalg.norm(guesses[-1] - share * change - end)


def test_a_change_is_taken_along_by_the_share_that_foretold_the_last_one_up_to_the_peak_alone():
    forecast = counting().problem.forecast
    ones = np.ones_like(forecast.change)
    shares, next_ones = [], []
    for increment, reactions in [
        (1.0, 1.0), (2.0, 2.0),  # the first change: there is nothing to judge it by
        (2.8, 3.0), (3.0, 4.0), (3.5, 5.0),  # 0.8 of the one before, 0.25, more than all
        (3.9, 4.9),  # behind the peak; 0.4 after 0.5 was clearly foretold
        (4.0, 4.8), (4.0, 6.0),  # 0.1 after 0.4 was not; larger than ever again
    ]:  # fmt: skip
        forecast.note(1.0, increment * ones, reactions)
        shares.append(forecast.share)
        next_ones.append(forecast.increment(1.0)[0])
    np.testing.assert_allclose(shares, [0.0, 1.0, 0.8, 0.5, 1.0, 1.0, 0.0, 0.5])
    np.testing.assert_allclose(next_ones, [1.0, 3.0, 3.44, 3.1, 4.0, 4.3, 4.0, 4.0])
    forecast.note(0.5, 2.1 * ones, 5.0)
    np.testing.assert_allclose(forecast.increment(2.0), 2 * 4.2 * ones)


@pytest.mark.parametrize("older", [False, True])
def test_a_forecast_comes_back_from_a_file_and_from_one_that_knew_only_whether_a_change_goes_on(
    older, tmp_path
):
    problem, other = counting().problem, counting().problem
    size = len(problem.forecast.change)
    for growth, reactions in ((1.0, 1.0), (1.1, 2.0), (1.3, 3.0)):
        problem.forecast.note(0.1, growth * np.arange(size), reactions)
    with h5py.File(tmp_path / "state.h5", "w") as file:
        problem.save(file)
        if older:
            del file["share_of_change"], file["largest_reactions"]
            file["change_goes_on"] = np.ones(len(file["step"]), bool)
        other.load(file)
    assert other.forecast.share == 1.0
    assert other.forecast.largest_reactions == (0.0 if older else 3.0)
    np.testing.assert_array_equal(other.forecast.increment(0.1), problem.forecast.increment(0.1))


def test_the_first_guess_by_the_tangent_costs_an_evaluation_in_the_first_step_alone():
    specimen = counting()
    specimen.problem.first_guess = "tangent"
    for step in range(3):
        specimen.compress(0.01 * step, 0.01 * (step + 1))
        solution = specimen.problem.solve()
        assert solution.converged
        assert solution.evaluations == solution.iterations + 1 + (step == 0)
        specimen.problem.accept()


def test_an_unknown_first_guess_is_answered_with_the_known_ones():
    problem = counting().problem
    arguments = problem.u, None, None, problem.operator, []
    with pytest.raises(ValueError, match="'best'; choose from increment, tangent"):
        Problem(*arguments, first_guess="best")


@pytest.mark.parametrize("formulation", ["small", "finite"])
def test_newton_with_the_exact_tangent_is_quadratic(formulation, petsc_options):
    petsc_options("-femxdem_snes_type newtonls")
    specimen = Specimen(
        lambda points: NeoHookean(points.size, 100.0, 0.3),
        formulation=formulation, rough=True, tolerance=1e-12,
    )  # fmt: skip
    specimen.problem.first_guess = "tangent"
    norms = []
    specimen.problem.snes.setMonitor(lambda snes, iteration, norm: norms.append(norm))
    specimen.compress(0.0, 0.1)
    assert specimen.problem.solve().converged
    digits = -np.log(np.array([norm for norm in norms if norm > 1e-9 * norms[0]]) / norms[0])
    orders = np.diff(digits)[1:] / np.diff(digits)[:-1]
    assert len(orders) >= 1 and orders[-1] > 1.7, (norms, orders)


def test_snes_asking_again_at_the_same_point_costs_nothing():
    specimen = counting()
    snes, f = specimen.problem.snes, specimen.problem._x.duplicate()
    x = f.duplicate()
    snes.computeFunction(x, f)
    first = f.norm()
    snes.computeFunction(x, f)
    assert specimen.law.evaluations == 1
    x.shift(1e-300)  # another point is another point, however near
    snes.computeFunction(x, f)
    assert specimen.law.evaluations == 2
    assert f.norm() == first


def test_the_law_is_committed_at_the_very_iterate_that_is_accepted():
    specimen = counting(distortion=0.0)
    specimen.compress(0.0, 0.05)
    specimen.problem.solve()
    first = specimen.points.volumes()
    specimen.law.evaluate(np.tile(1.1 * np.eye(2), (specimen.points.size, 1, 1)))
    specimen.problem.balance.restart()  # as if the last evaluation had been elsewhere
    specimen.problem.accept()
    # what the law was told is what the mesh did
    J = np.linalg.det(specimen.law._state["F"])
    np.testing.assert_allclose(specimen.points.volumes(), J * first, rtol=1e-12)


def test_rejecting_a_step_leaves_no_trace():
    specimen, other = counting(), counting()
    specimen.compress(0.0, 0.2)
    specimen.problem.solve()
    specimen.problem.reject()
    assert not specimen.u.x.array.any()
    for each in (specimen, other):
        each.compress(0.0, 0.05)
        each.problem.solve()
        each.problem.accept()
    assert specimen.top_force() == other.top_force()


def test_the_default_scheme_needs_few_evaluations_with_a_tangent_that_is_too_stiff(petsc_options):
    evaluations = {}
    for scheme in ("python", "newtonls"):
        petsc_options(f"-femxdem_snes_type {scheme}")
        specimen = Specimen(
            lambda points: TooStiff(points.size), rough=True, tolerance=1e-2, max_iterations=50
        )
        count = []
        for step in range(8):
            specimen.compress(0.01 * step, 0.01 * (step + 1))
            solution = specimen.problem.solve()
            assert solution.converged
            specimen.problem.accept()
            count.append(solution.evaluations)
        evaluations[scheme] = np.mean(count[1:])
    assert evaluations["python"] <= 3.0
    assert evaluations["python"] <= evaluations["newtonls"]


@pytest.mark.parametrize(
    "words",
    [
        "-femxdem_snes_type bananas",
        "-femxdem_ksp_type bananas",
        "-femxdem_pc_factor_mat_solver_type bananas",
        "-femxdem_snes_anderson_m bananas",
    ],
)
def test_an_option_that_petsc_does_not_take_is_told_before_anything_is_solved(words, petsc_options):
    petsc_options(words)
    with pytest.raises(ValueError, match=f"^PETSc does not take one of the options {words}"):
        counting()


@pytest.mark.parametrize("scheme", ["python", "newtonls", "qn"])
def test_an_astray_first_guess_is_a_failed_solve_and_no_crash(scheme, petsc_options):
    petsc_options(f"-femxdem_snes_type {scheme}")
    specimen = Specimen(lambda points: NeoHookean(points.size, 100.0, 0.3), tolerance=1e-4)
    specimen.compress(0.0, 0.9)
    solution = specimen.problem.solve()
    assert not solution.converged
    assert "went astray" in solution.reason
    assert not solution.residual <= 5e-2
    specimen.problem.reject()
    specimen.compress(0.0, 0.01)
    assert specimen.problem.solve().converged


@pytest.mark.parametrize("scheme", ["python", "newtonls", "qn"])
def test_an_iterate_that_goes_astray_later_is_a_failed_solve_too(scheme, petsc_options):
    petsc_options(f"-femxdem_snes_type {scheme}")
    error = InadmissibleDeformation("lost")
    specimen = Specimen(lambda points: Failing(points.size, error), rough=True)
    specimen.compress(0.0, 0.1)
    solution = specimen.problem.solve()
    assert not solution.converged and solution.reason == "lost" and solution.evaluations == 3
    assert 0 < solution.residual < 1


@pytest.mark.parametrize("after", [0, 1, 2])
@pytest.mark.parametrize("scheme", ["python", "newtonls"])
def test_any_other_error_of_the_law_ends_the_solve_as_it_is(scheme, after, petsc_options):
    petsc_options(f"-femxdem_snes_type {scheme}")
    error = ZeroDivisionError("no grains")
    specimen = Specimen(lambda points: Failing(points.size, error, after=after), rough=True)
    specimen.compress(0.0, 0.1)
    with pytest.raises(ZeroDivisionError, match="no grains"):
        specimen.problem.solve()


def test_an_error_of_the_tangent_ends_the_solve_as_it_is():
    specimen = Specimen(lambda points: NoTangent(points.size, 100.0, 0.3), rough=True)
    specimen.compress(0.0, 0.1)
    with pytest.raises(ArithmeticError, match="no tangent here"):
        specimen.problem.solve()


def test_a_singular_tangent_is_a_failed_solve():
    specimen = Specimen(lambda points: NoStiffness(points.size, 100.0, 0.3), formulation="small")
    specimen.compress(0.0, 0.01)
    for _ in range(2):
        solution = specimen.problem.solve()
        assert not solution.converged
        assert solution.reason == "DIVERGED_LINEAR_SOLVE"
        specimen.problem.reject()


def test_what_the_law_cannot_follow_is_the_reason_of_a_failed_solve():
    specimen = Specimen(lambda points: Fragile(points.size, 0.01))
    specimen.compress(0.0, 0.05)
    assert specimen.problem.solve().reason == "grains lose their neighbours"


def test_an_unconverged_solve_leaves_the_best_iterate():
    specimen = Specimen(lambda points: Noisy(points.size, 0.03), tolerance=1e-6, rough=True)
    norms = []
    specimen.problem.snes.setMonitor(lambda snes, iteration, norm: norms.append(norm))
    specimen.compress(0.0, 0.01)
    solution = specimen.problem.solve()
    assert not solution.converged
    assert solution.reason == "DIVERGED_MAX_IT"
    specimen.problem.accept()
    free = np.delete(specimen.problem.balance.forces.array, specimen.problem.balance.constrained)
    assert np.linalg.norm(free) == pytest.approx(min(norms))


def test_displacement_criterion_alone_asks_for_a_correction_first():
    specimen = Specimen(lambda points: LinearElastic(points.size, 100.0, 0.3), formulation="small")
    specimen.compress(0.0, 0.01)
    specimen.problem.convergence = Convergence(force=None, displacement=1e-2)
    assert specimen.problem.solve().iterations == 1
    specimen.problem.reject()
    specimen.problem.convergence = Convergence(force=1e-2)
    assert specimen.problem.solve().iterations == 0


@pytest.mark.parametrize(
    "arguments",
    [
        {"force": None},
        {"force": 0.0},
        {"displacement": -1.0},
        {"force": np.inf},
        {"force": np.nan},
        {"max_iterations": 0},
    ],
)
def test_criteria_that_cannot_hold_are_refused(arguments):
    with pytest.raises(ValueError, match="give positive limits, one at least"):
        Convergence(**arguments)


def test_options_of_the_command_line_win_and_ours_do_not_stay(petsc_options):
    petsc_options("-femxdem_snes_max_it 3 -femxdem_pc_factor_mat_solver_type petsc")
    specimen = counting()
    assert specimen.problem.snes.getTolerances()[3] == 3
    assert specimen.problem.snes.getType() == "python"
    assert specimen.problem.snes.getKSP().getPC().getFactorSolverType() == "petsc"
    assert not PETSc.Options().hasName("femxdem_snes_type")


def test_leftover_arguments_reach_petsc(petsc_options):
    pass_on(["-femxdem_snes_max_it", "7", "-femxdem_snes_atol", "-1e-3", "-femxdem_snes_monitor"])
    assert PETSc.Options().getInt("femxdem_snes_max_it") == 7
    assert PETSc.Options().hasName("femxdem_snes_monitor")


@pytest.mark.parametrize("arguments", [["--elemnt", "Q8"], ["Q8"], ["-a", "1", "2"]])
def test_a_misspelt_argument_is_no_petsc_option(arguments, petsc_options):
    with pytest.raises(ValueError, match="unknown argument"):
        pass_on(arguments)
