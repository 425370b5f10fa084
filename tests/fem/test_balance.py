"""Nodal forces: what they work, what is out of balance, what is evaluated for it and how often."""

import numpy as np
import pytest

from femxdem_fenicsx.law import LinearElastic
from tests.fem.laws import Counting
from tests.fem.specimen import Specimen


@pytest.fixture
def specimen() -> Specimen:
    return Specimen(lambda points: Counting(points.size), formulation="small", rough=True)


@pytest.fixture
def increment(specimen) -> np.ndarray:
    size = specimen.problem.balance.size
    return 1e-2 * np.random.default_rng(1).normal(size=size)


def test_the_law_is_evaluated_where_u_is_new_and_nowhere_else(specimen, increment):
    balance = specimen.problem.balance
    for u, evaluations in ((increment, 1), (increment, 1), (0.5 * increment, 2)):
        balance.place(u)
        balance.evaluate()
        assert specimen.law.evaluations == evaluations
    np.testing.assert_array_equal(balance.now.u, 0.5 * increment)
    np.testing.assert_array_equal(balance.before.u, increment)
    assert balance.correction() == pytest.approx(1.0)


def test_the_best_iterate_is_the_one_least_out_of_balance(specimen, increment):
    balance = specimen.problem.balance
    specimen.compress(0.0, 1e-3)
    assert specimen.problem.solve().converged
    solution = specimen.u.x.array.copy()
    balance.restart()
    for u in (solution + increment, solution, solution + 0.1 * increment):
        balance.place(u)
        balance.evaluate()
    np.testing.assert_array_equal(balance.best.u, solution)
    assert balance.best.ratio < 1e-9 < balance.now.ratio


def test_forces_of_a_stress_times_an_increment_are_the_integral_of_stress_and_strain(
    specimen, increment
):
    balance, points = specimen.problem.balance, specimen.points
    stress = np.random.default_rng(2).normal(size=(points.size, 2, 2))
    stress += np.swapaxes(stress, 1, 2)
    strain = balance.deformation_gradient(increment) - np.eye(2)
    work = (points.volumes() * (stress * strain).sum(axis=(1, 2))).sum()
    assert balance.forces_of(stress).array @ increment == pytest.approx(work)
    assert not specimen.u.x.array.any()


def test_the_stress_behind_an_increment_is_that_of_its_strain_and_u_is_zero_again():
    specimen = Specimen(lambda points: LinearElastic(points.size, 100.0, 0.3), formulation="small")
    balance = specimen.problem.balance
    increment = np.tile([1e-3, -2e-3], balance.size // 2)  # all nodes the same: no strain
    assert np.abs(balance.stress_at(increment)).max() < 1e-12
    increment *= np.random.default_rng(3).normal(size=balance.size)
    assert np.abs(balance.stress_at(increment)).max() > 1e-2
    assert not specimen.u.x.array.any()


def test_of_prescribed_values_u_has_the_share_that_it_was_given(specimen):
    balance = specimen.problem.balance
    specimen.compress(0.0, 1e-3)
    balance.read_prescribed()
    u = np.zeros(balance.size)
    u[balance.constrained] = 0.3 * balance.prescribed
    balance.place(u)
    assert balance.load_share() == pytest.approx(0.3)
