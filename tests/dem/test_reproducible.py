"""Small matrices and elementary functions without BLAS, LAPACK or libm, against those."""

import math

import numpy as np
import pytest

from femxdem_fenicsx.dem import reproducible

RNG = np.random.default_rng(1)


@pytest.mark.parametrize("dim", [2, 3])
def test_stacks_of_matrices_are_what_lapack_says(dim):
    a = RNG.normal(size=(500, dim, dim))
    symmetric = a + reproducible.transposed(a)
    kwargs = {"rtol": 0, "atol": 1e-13}
    np.testing.assert_allclose(reproducible.determinant(a), np.linalg.det(a), **kwargs)
    np.testing.assert_allclose(reproducible.product(a, symmetric), a @ symmetric, **kwargs)
    np.testing.assert_allclose(
        reproducible.eigenvalues(symmetric), np.linalg.eigvalsh(symmetric), **kwargs
    )
    inverse = reproducible.inverse(a)
    residual = reproducible.product(inverse, a) - np.eye(dim)
    assert (np.abs(residual).max((1, 2)) < 1e-14 * np.linalg.cond(a) ** 2 + 1e-14).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_eigenvalues_that_are_equal_or_nearly_so_are_as_exact(dim):
    for matrix in (
        np.zeros((dim, dim)),
        np.eye(dim),
        1e5 * np.eye(dim) + 1e-4 * np.ones((dim, dim)),
    ):
        np.testing.assert_allclose(
            reproducible.eigenvalues(matrix), np.linalg.eigvalsh(matrix), rtol=1e-15, atol=1e-300
        )


@pytest.mark.parametrize("dim", [2, 3])
def test_a_matrix_without_an_inverse_gives_values_that_are_not_finite(dim):
    assert not np.isfinite(reproducible.inverse(np.zeros((1, dim, dim)))).any()


@pytest.mark.parametrize(
    ("ours", "theirs", "low", "high"),
    [
        (reproducible.log, np.log, 1e-300, 1e300),
        (reproducible.log, np.log, 0.9, 1.1),
        (reproducible.exp, np.exp, -700.0, 700.0),
        (reproducible.arctan, np.arctan, -30.0, 30.0),
        (reproducible.arcsin, np.arcsin, -1.0, 1.0),
    ],
)
def test_functions_are_right_to_a_few_units_of_the_last_place(ours, theirs, low, high):
    x = np.append(RNG.uniform(low, high, 20000), [low, high, 1.0])
    np.testing.assert_allclose(ours(x), theirs(x), rtol=2e-15, atol=0)


def test_where_functions_have_an_exact_value_it_is_exact():
    assert reproducible.log(1.0) == 0.0
    assert reproducible.exp(0.0) == 1.0
    assert reproducible.arcsin(1.0) == math.pi / 2
    assert reproducible.arcsin(-1.0) == -math.pi / 2
    assert reproducible.arctan(0.0) == 0.0


def test_powers_sequences_and_slopes():
    x = np.array([1e-6, 0.3, 7.0])
    np.testing.assert_allclose(reproducible.power(x, -2.5), x**-2.5, rtol=1e-13)
    values = reproducible.geometric(3.0, 3e4, 9)
    np.testing.assert_allclose(values, np.geomspace(3.0, 3e4, 9), rtol=1e-14)
    assert (values[0], values[-1]) == (3.0, 3e4)
    y = RNG.normal(size=3)
    assert reproducible.slope(x, y) == pytest.approx(np.polyfit(x, y, 1)[0])
    assert reproducible.slope(np.ones(3), y) == 0.0


def test_rounding_takes_the_noise_of_a_library_away():
    x = RNG.uniform(0.1, 10.0, 1000)
    noisy = x * (1 + 4e-16 * RNG.uniform(-1, 1, 1000))
    np.testing.assert_array_equal(reproducible.rounded(noisy), reproducible.rounded(x))
    np.testing.assert_allclose(reproducible.rounded(x), x, rtol=2.0**-24)
    assert reproducible.rounded_to_bits(math.pi, 13) == 3.1416015625
    assert reproducible.rounded_to_bits(-math.pi * 2.0**90, 13) == -3.1416015625 * 2.0**90
