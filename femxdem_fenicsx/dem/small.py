"""Algebra of 2 x 2 and 3 x 3 matrices in kernels, where LAPACK would cost seconds to compile."""

import math

import numpy as np

from .aliasing import kernel


@kernel
def determinant(a):
    """det a of a 2 x 2 or 3 x 3 matrix."""
    if a.shape[0] == 2:
        return a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    return (
        a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
        - a[0, 1] * (a[1, 0] * a[2, 2] - a[1, 2] * a[2, 0])
        + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
    )


@kernel
def inverse(a):
    """Inverse of a 2 x 2 or 3 x 3 matrix: adjugate over determinant."""
    result = np.empty_like(a)
    scale = 1.0 / determinant(a)
    if a.shape[0] == 2:
        result[0, 0], result[0, 1] = scale * a[1, 1], -scale * a[0, 1]
        result[1, 0], result[1, 1] = -scale * a[1, 0], scale * a[0, 0]
        return result
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            n, p = (m + 1) % 3, (m + 2) % 3
            result[m, i] = scale * (a[j, n] * a[k, p] - a[j, p] * a[k, n])
    return result


@kernel
def product(a, b):
    """a b of square matrices."""
    dim = a.shape[0]
    result = np.zeros((dim, dim))
    for i in range(dim):
        for j in range(dim):
            for k in range(dim):
                result[i, j] += a[i, k] * b[k, j]
    return result


@kernel
def least_stretch(a):
    """A lower bound of the least singular value; exact in 2D, and in 3D for uniaxial strain.

    The least eigenvalue of a symmetric d x d matrix c is no less than its mean, tr c / d, less
    sqrt((d - 1) / d) times the norm of its deviator; here c = a^T a.
    """
    dim = a.shape[0]
    trace = squared = 0.0
    for i in range(dim):
        for j in range(dim):
            c = 0.0
            for k in range(dim):
                c += a[k, i] * a[k, j]
            squared += c * c
            trace += c if i == j else 0.0
    mean = trace / dim
    deviator = math.sqrt(max(squared - dim * mean * mean, 0.0) * (dim - 1) / dim)
    return math.sqrt(max(mean - deviator, 0.0))
