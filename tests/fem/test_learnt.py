"""What the solver has learnt goes through a file, as it was at the end of the last step."""

import h5py
import numpy as np
import pytest
from petsc4py import PETSc

from femxdem_fenicsx.fem.problem import Problem
from tests.fem.laws import Counting
from tests.fem.specimen import Specimen

STEP = 0.05


@pytest.fixture(autouse=True)
def keeping(petsc_options):
    petsc_options("-femxdem_snes_anderson_keep 1")


def specimen(**options) -> Specimen:
    return Specimen(lambda points: Counting(points.size, points.mesh.geometry.dim), **options)


def take_steps(specimen: Specimen, *numbers: int) -> None:
    for number in numbers:
        specimen.compress(STEP * number, STEP * (number + 1))
        specimen.problem.solve()
        specimen.problem.accept()


def in_file(problem: Problem) -> h5py.File:
    file = h5py.File("memory", "w", driver="core", backing_store=False)
    problem.save(file)
    return file


def arrays(problem: Problem) -> dict[str, np.ndarray]:
    with in_file(problem) as file:
        return {name: file[name][()] for name in file}


@pytest.mark.parametrize(
    "name, modulus", [("Q4", None), ("Q8", None), ("H8", None), ("Q8", 0.5), ("T6", 0.5)]
)
def test_matrix_and_differences_come_back_bit_for_bit(name, modulus):
    first, second = (specimen(name=name, modulus=modulus, rough=True) for _ in range(2))
    take_steps(first, 0, 1)
    saved = arrays(first.problem)
    assert len(saved["jacobian"]) == len(saved["differences"]) == len(saved["increment"])
    assert saved["differences"].shape[1] in (2, 4, 6, 8, 10)  # dX and dG
    with in_file(first.problem) as file:
        second.problem.load(file)
    for name, array in arrays(second.problem).items():
        np.testing.assert_array_equal(array, saved[name], err_msg=name)
    difference = first.problem._matrix.copy()
    difference.axpy(-1.0, second.problem._matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    assert difference.norm() == 0.0 < first.problem._matrix.norm()


def test_a_step_that_is_given_up_changes_nothing_of_what_is_saved():
    body = specimen(rough=True)
    take_steps(body, 0, 1)
    before, tangents = arrays(body.problem), body.law.tangents
    body.problem.forget()
    body.compress(STEP * 2, STEP * 3)
    body.problem.solve()
    assert body.law.tangents == tangents + 1
    body.problem.reject()
    after = arrays(body.problem)
    assert after.keys() == before.keys() and "jacobian" in before
    for name, array in before.items():
        np.testing.assert_array_equal(after[name], array, err_msg=name)


@pytest.mark.parametrize("serves", [True, False])
def test_a_jacobian_goes_on_to_serve_unless_it_was_given_up(serves):
    first, second = specimen(rough=True), specimen(rough=True)
    take_steps(first, 0)
    if not serves:  # an accepted iterate that is not converged
        first.problem.snes.setTolerances(max_it=1)
    take_steps(first, 1)
    with in_file(first.problem) as file:
        second.problem.load(file)
    take_steps(second, 2)
    assert second.law.tangents == (0 if serves else 1)
