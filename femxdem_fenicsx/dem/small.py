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
def smallest_singular_value(a):
    """Of a 2 x 2 or 3 x 3 matrix; in 3D the root of the smallest eigenvalue of a^T a (Cardano)."""
    if a.shape[0] == 2:
        both = math.hypot(a[0, 0] + a[1, 1], a[1, 0] - a[0, 1])
        return 0.5 * (both - math.hypot(a[0, 0] - a[1, 1], a[1, 0] + a[0, 1]))
    c = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                c[i, j] += a[k, i] * a[k, j]
    mean = (c[0, 0] + c[1, 1] + c[2, 2]) / 3.0
    squared = 0.0
    for i in range(3):
        c[i, i] -= mean
        for j in range(3):
            squared += c[i, j] ** 2
    size = math.sqrt(squared / 6.0)
    if size == 0.0:
        return math.sqrt(mean)
    cosine = min(max(determinant(c) / (2.0 * size**3), -1.0), 1.0)
    smallest = mean + 2.0 * size * math.cos((math.acos(cosine) + 2.0 * math.pi) / 3.0)
    return math.sqrt(max(smallest, 0.0))
