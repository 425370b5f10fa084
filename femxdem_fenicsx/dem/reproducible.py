"""Numbers with the same bits on every CPU: small matrices in stacks, and elementary functions.

The operations +, -, *, / and sqrt are exactly those of IEEE 754 everywhere, and so is a sum whose
terms have an order. What BLAS, LAPACK, libm and NumPy's own exp, log, sin or power (x**3 as well)
return depends on the CPU, and on their version, in the last bits. Grains amplify the last bit of
anything that they see until packings part, so whatever stands between a seed and a stress is
computed by the functions in here.
(`small` has the same algebra for kernels.)

Matrices are 2 x 2 or 3 x 3, arrays (..., d, d).
"""

import math

import numpy as np

#: Of ln 2: a part of 32 bits, whose multiples are exact, and the rest.
LN2_HIGH, LN2_LOW = 0.693147180369123816490, 1.90821492927058770002e-10
#: Terms of the series below, which are enough for the last bit.
LOG_TERMS, EXP_TERMS, ARCTAN_TERMS = 11, 15, 12
#: Sweeps of Jacobi's iteration, which converges quadratically: 3 x 3 matrices need four.
SWEEPS = 6


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a b, of stacks (..., m, d) and (..., d, n), as `@` but for the order of its sums."""
    terms = (a[..., :, k, None] * b[..., None, k, :] for k in range(a.shape[-1]))
    return sum(terms)


def transposed(a: np.ndarray) -> np.ndarray:
    """a^T of a stack."""
    return np.swapaxes(a, -1, -2)


def determinant(a: np.ndarray) -> np.ndarray:
    """det a, shape (...)."""
    if a.shape[-1] == 2:
        return a[..., 0, 0] * a[..., 1, 1] - a[..., 0, 1] * a[..., 1, 0]
    return sum(a[..., 0, m] * _cofactor(a, 0, m) for m in range(3))


def inverse(a: np.ndarray) -> np.ndarray:
    """a^-1: adjugate over determinant; not finite where that is zero."""
    a = np.asarray(a, dtype=np.float64)
    adjugate = np.empty_like(a)
    if a.shape[-1] == 2:
        adjugate[..., 0, 0], adjugate[..., 1, 1] = a[..., 1, 1], a[..., 0, 0]
        adjugate[..., 0, 1], adjugate[..., 1, 0] = -a[..., 0, 1], -a[..., 1, 0]
    else:
        for i in range(3):
            for m in range(3):
                adjugate[..., m, i] = _cofactor(a, i, m)
    with np.errstate(divide="ignore", invalid="ignore"):
        return adjugate / determinant(a)[..., None, None]


def _cofactor(a: np.ndarray, i: int, m: int) -> np.ndarray:
    j, k, n, p = (i + 1) % 3, (i + 2) % 3, (m + 1) % 3, (m + 2) % 3
    return a[..., j, n] * a[..., k, p] - a[..., j, p] * a[..., k, n]


def eigenvalues(a: np.ndarray) -> np.ndarray:
    """Of symmetric matrices, increasing, shape (..., d)."""
    a = np.array(a, dtype=np.float64)
    if a.shape[-1] == 2:
        mean = 0.5 * (a[..., 0, 0] + a[..., 1, 1])
        half = 0.5 * (a[..., 0, 0] - a[..., 1, 1])
        radius = np.sqrt(half * half + a[..., 0, 1] * a[..., 1, 0])
        return np.stack([mean - radius, mean + radius], -1)
    for _ in range(SWEEPS):
        for p, q in ((0, 1), (0, 2), (1, 2)):
            _annihilate(a, p, q)
    return np.sort(np.diagonal(a, axis1=-2, axis2=-1), axis=-1)


def _annihilate(a: np.ndarray, p: int, q: int) -> None:
    """Turn symmetric 3 x 3 matrices, in place, so that a[p, q] vanishes (Jacobi)."""
    r = 3 - p - q
    off, gap = a[..., p, q].copy(), 0.5 * (a[..., q, q] - a[..., p, p])
    reach = np.abs(gap) + np.sqrt(gap * gap + off * off)
    t = np.where(gap < 0, -off, off) / np.where(reach > 0, reach, 1.0)
    c = 1.0 / np.sqrt(t * t + 1.0)
    s = t * c
    a[..., p, p] -= t * off
    a[..., q, q] += t * off
    a[..., p, q] = a[..., q, p] = 0.0
    first, second = a[..., r, p].copy(), a[..., r, q].copy()
    a[..., r, p] = a[..., p, r] = c * first - s * second
    a[..., r, q] = a[..., q, r] = s * first + c * second


def inner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a : b of matrices, shape (...), summed row by row."""
    terms = a * b
    d = terms.shape[-1]
    return sum(terms[..., i, j] for i in range(d) for j in range(d))


def log(x: np.ndarray | float) -> np.ndarray:
    """Natural logarithm of positive numbers, to a few units of the last place."""
    share, power = np.frexp(np.asarray(x, dtype=np.float64))  # share in [1/2, 1[
    low = share < np.sqrt(0.5)
    share, power = np.where(low, 2.0 * share, share), power - low
    z = (share - 1.0) / (share + 1.0)
    return power * LN2_HIGH + (2.0 * _odd_series(z, LOG_TERMS, 1.0) + power * LN2_LOW)


def exp(x: np.ndarray | float) -> np.ndarray:
    """Exponential function, to a few units of the last place."""
    x = np.asarray(x, dtype=np.float64)
    power = np.rint(x / (LN2_HIGH + LN2_LOW))
    rest = (x - power * LN2_HIGH) - power * LN2_LOW
    total = np.ones_like(rest)
    for k in range(EXP_TERMS, 0, -1):
        total = 1.0 + total * rest / k
    return np.ldexp(total, power.astype(np.int64))


def power(x: np.ndarray | float, exponent: float) -> np.ndarray:
    """x to a power, of positive numbers."""
    return exp(exponent * log(x))


def arctan(x: np.ndarray | float) -> np.ndarray:
    """In ]-pi/2, pi/2[, to a few units of the last place."""
    x = np.asarray(x, dtype=np.float64)
    far = np.abs(x) > 1.0
    near = np.where(far, 1.0 / np.where(far, x, 1.0), x)
    for _ in range(2):  # half the angle twice: |x| < 0.2
        near = near / (1.0 + np.sqrt(1.0 + near * near))
    angle = 4.0 * _odd_series(near, ARCTAN_TERMS, -1.0)
    return np.where(far, np.copysign(0.5 * np.pi, x) - angle, angle)


def arcsin(x: np.ndarray | float) -> np.ndarray:
    """In [-pi/2, pi/2], of numbers in [-1, 1]."""
    x = np.asarray(x, dtype=np.float64)
    angle = 2.0 * arctan(x / (1.0 + np.sqrt((1.0 - x) * (1.0 + x))))
    return np.where(np.abs(x) == 1.0, np.copysign(0.5 * np.pi, x), angle)


def _odd_series(z: np.ndarray, terms: int, sign: float) -> np.ndarray:
    """z + sign z^3 / 3 + z^5 / 5 + ...: artanh z with the sign 1, arctan z with -1."""
    square, total = sign * z * z, np.zeros_like(z)
    for k in range(2 * terms + 1, 1, -2):
        total = (total + 1.0 / k) * square
    return z + z * total


def geometric(first: float, last: float, number: int) -> np.ndarray:
    """`number` values of equal ratio from `first` to `last`, both positive; the ends are exact."""
    share = np.arange(number) / (number - 1)
    values = first * exp(share * float(log(last / first)))
    values[0], values[-1] = first, last
    return values


def slope(x: np.ndarray, y: np.ndarray) -> float:
    """Of the straight line through points (n,) by least squares; 0 where all x are the same."""
    apart = x - x.mean()
    squared = (apart * apart).sum()
    return float((apart * (y - y.mean())).sum() / squared) if squared > 0 else 0.0


def rounded_to_bits(x: float, bits: int) -> float:
    """x to so many significant bits: far fewer than a library that computed it gets right."""
    share, power = math.frexp(x)
    return math.ldexp(round(math.ldexp(share, bits)), power - bits)


def rounded(x: np.ndarray) -> np.ndarray:
    """Values to 24 significant bits, as single precision has: see `rounded_to_bits`."""
    return np.asarray(x, dtype=np.float32).astype(np.float64)
