"""Linear isotropic laws of the double stress: constants, and the tensor that they make.

The double stress Sigma_ijk works on the second gradient E_ijk = d^2 u_i / dx_j dx_k (Desrues
eq. 34). Only the part of E that is symmetric in j and k counts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Of Mindlin's constants for the one-parameter law, as multiples of D.
ONE_PARAMETER = (0.0, 0.5, 0.0, 0.5, -0.5)


def mindlin(constants: Sequence[float], dim: int = 2) -> np.ndarray:
    """A of Sigma_ijk = A_ijklmn E_lmn, the general isotropic law, (d,) * 6, N.

    A is the second derivative of Mindlin's energy, form I (Mindlin 1964):
    W = a1 b . a + a2 a . a + a3 b . b + a4 E_ijk E_ijk + a5 E_ijk E_jik, with the gradient of the
    divergence a_i = E_jji and the Laplacian b_i = E_ijj.

    Args:
        constants: a1 to a5, N.
        dim: 2 or 3.

    Raises:
        ValueError: constants that are not five numbers, or with a negative energy for some E.
    """
    if len(constants) != 5 or not np.isfinite(constants).all():
        raise ValueError(f"double stress with constants {constants}: Mindlin's law has five, in N")
    one = np.eye(dim)
    laplacian = np.einsum("ai,jk->aijk", one, one)
    divergence = 0.5 * (np.einsum("ij,ak->aijk", one, one) + np.einsum("ik,aj->aijk", one, one))
    symmetric = 0.5 * np.einsum("il,jm,kn->ijklmn", one, one, one)
    symmetric += 0.5 * np.einsum("il,jn,km->ijklmn", one, one, one)
    turned = np.einsum("pqrijk,qprlmn->ijklmn", symmetric, symmetric)
    mixed = np.einsum("aijk,almn->ijklmn", laplacian, divergence)
    invariants = (
        0.5 * (mixed + mixed.transpose(3, 4, 5, 0, 1, 2)),
        np.einsum("aijk,almn->ijklmn", divergence, divergence),
        np.einsum("aijk,almn->ijklmn", laplacian, laplacian),
        symmetric,
        0.5 * (turned + turned.transpose(3, 4, 5, 0, 1, 2)),
    )
    A = 2.0 * sum(a * form for a, form in zip(constants, invariants, strict=True))
    lowest, *_, highest = np.linalg.eigvalsh(A.reshape(dim**3, dim**3))
    if lowest < -1e-9 * abs(highest):
        raise ValueError(
            f"double stress with constants {tuple(constants)} N: its energy is negative for some "
            f"second gradient in {dim}D (smallest eigenvalue {lowest:.3g} N); it must not be"
        )
    return A


def one_parameter(modulus: float, dim: int = 2) -> np.ndarray:
    """A of the law with one modulus D (Desrues eq. 44), (d,) * 6, N.

    Its energy is W = D/2 (|grad tr e|^2 + |grad r|^2 / 2), with the strain e and
    r_ij = u_i,j - u_j,i: the gradients of dilation and of rotation. In 2D this is eq. 44; in 3D
    it is the law of the same energy.

    Raises:
        ValueError: D is not positive.
    """
    if modulus == 0:
        raise ValueError("second gradient with D = 0 is a first gradient: use --gradient first")
    if not (modulus > 0 and np.isfinite(modulus)):
        raise ValueError(f"second-gradient modulus D = {modulus} N: it must be positive")
    return modulus * mindlin(ONE_PARAMETER, dim)
