"""The double stress of Desrues eq. 44 and Mindlin's general law."""

import numpy as np
import pytest

from femxdem_fenicsx.double_stress import mindlin, one_parameter

#: Desrues eq. 44 with D = 1, components in the order 111, 112, 121, 122, 211, ...
EQUATION_44 = [
    [1, 0, 0, 0, 0, 0.5, 0.5, 0],
    [0, 0.5, 0.5, 0, -0.5, 0, 0, 0.5],
    [0, 0.5, 0.5, 0, -0.5, 0, 0, 0.5],
    [0, 0, 0, 1, 0, -0.5, -0.5, 0],
    [0, -0.5, -0.5, 0, 1, 0, 0, 0],
    [0.5, 0, 0, -0.5, 0, 0.5, 0.5, 0],
    [0.5, 0, 0, -0.5, 0, 0.5, 0.5, 0],
    [0, 0.5, 0.5, 0, 0, 0, 0, 1],
]
CONSTANTS = (0.3, 0.5, 0.4, 0.9, -0.2)


def turned(tensor: np.ndarray, Q: np.ndarray) -> np.ndarray:
    for axis in range(tensor.ndim):
        tensor = np.moveaxis(np.tensordot(Q, tensor, (1, axis)), 0, axis)
    return tensor


def test_the_one_parameter_law_is_equation_44():
    np.testing.assert_allclose(one_parameter(3.0).reshape(8, 8), 3 * np.array(EQUATION_44))


def test_the_8x8_matrix_is_positive_semidefinite_with_four_zeros():
    eigenvalues = np.linalg.eigvalsh(one_parameter(3.0).reshape(8, 8))
    np.testing.assert_allclose(eigenvalues, 3 * np.array([0, 0, 0, 0, 1, 1, 2, 2]), atol=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("make", [one_parameter, mindlin])
def test_laws_are_isotropic_symmetric_and_have_an_energy(dim, make):
    A = make(2.0 if make is one_parameter else CONSTANTS, dim)
    Q = np.linalg.qr(np.random.default_rng(3).normal(size=(dim, dim)))[0]
    np.testing.assert_allclose(turned(A, Q), A, atol=1e-12)
    np.testing.assert_allclose(A, A.transpose(3, 4, 5, 0, 1, 2), atol=1e-14)
    np.testing.assert_allclose(A, A.transpose(0, 2, 1, 3, 4, 5), atol=1e-14)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_law_is_the_derivative_of_mindlins_energy(dim):
    E = np.random.default_rng(4).normal(size=(dim,) * 3)
    E = E + E.transpose(0, 2, 1)
    a, b = np.einsum("jji->i", E), np.einsum("ijj->i", E)
    squares = (b @ a, a @ a, b @ b, (E * E).sum(), (E * E.transpose(1, 0, 2)).sum())
    Sigma = np.einsum("ijklmn,lmn->ijk", mindlin(CONSTANTS, dim), E)
    assert (Sigma * E).sum() / 2 == pytest.approx(np.dot(CONSTANTS, squares))


def test_plane_strain_of_the_one_parameter_law_in_3d_is_the_one_in_2d():
    A = one_parameter(1.0, 3)[:2, :2, :2, :2, :2, :2]
    np.testing.assert_allclose(A, one_parameter(1.0, 2), atol=1e-14)


def test_a_modulus_of_zero_is_told_to_use_the_first_gradient():
    with pytest.raises(ValueError, match="use --gradient first"):
        one_parameter(0.0)


@pytest.mark.parametrize("modulus", [-1.0, np.nan, np.inf])
def test_a_modulus_that_is_not_positive_is_refused(modulus):
    with pytest.raises(ValueError, match="must be positive"):
        one_parameter(modulus)


def test_constants_with_a_negative_energy_are_refused():
    with pytest.raises(ValueError, match="negative for some second gradient in 2D"):
        mindlin((0, 0, 0, 1, -2.0))
    with pytest.raises(ValueError, match="has five"):
        mindlin((1.0, 2.0))
