"""Laws that misbehave in the ways in which a packing does."""

from __future__ import annotations

import numpy as np

from femxdem_fenicsx.law import InadmissibleDeformation, LinearElastic, NeoHookean


class Counting(NeoHookean):
    """Counts what it is asked."""

    def __init__(self, size: int, dim: int = 2):
        super().__init__(size, 100.0, 0.3, dim)
        self.evaluations = self.tangents = 0
        self.committed_last = True

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        self.evaluations += 1
        self.F = F.copy()
        return super().evaluate(F)

    def tangent(self) -> np.ndarray:
        self.tangents += 1
        return super().tangent()


class TooStiff(NeoHookean):
    """Its tangent is 1.4 to 4 times the true one at rest, and constant, as the UKO is."""

    def __init__(self, size: int):
        super().__init__(size, 100.0, 0.3)
        self._stiff = LinearElastic(size, 100.0, 0.3).tangent() * np.einsum(
            "ij,kl->ijkl", [[2.0, 1.2], [1.2, 1.2]], [[2.0, 1.2], [1.2, 1.2]]
        )

    def tangent(self) -> np.ndarray:
        return self._stiff


class Noisy(LinearElastic):
    """The stress jumps with the last digits of F: no iterate is better balanced than the noise."""

    def __init__(self, size: int, noise: float):
        super().__init__(size, 100.0, 0.3)
        self._noise = noise

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        stress = super().evaluate(F)
        phase = 1e9 * F[:, :1, :1] + np.arange(self.size)[:, None, None]
        return stress * (1 + self._noise * np.sin(phase))


class Failing(LinearElastic):
    """Raises `error` from the n-th evaluation on, on the ranks where `fails` is true."""

    def __init__(self, size: int, error: Exception, fails: bool = True, after: int = 2):
        super().__init__(size, 100.0, 0.3)
        self._error, self._fails, self._left = error, fails, after

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        self._left -= 1
        if self._fails and self._left < 0:
            raise self._error
        return super().evaluate(F)


class NoStiffness(NeoHookean):
    """A tangent of zero, as of a packing without contacts that nobody took care of."""

    def tangent(self) -> np.ndarray:
        return np.zeros((self.size, 2, 2, 2, 2))


class NoTangent(NeoHookean):
    """Fails when the tangent is asked for in a solve, not at F = I."""

    def tangent(self) -> np.ndarray:
        if len(self._last) and np.abs(self._last[0] - np.eye(2)).max() > 0:
            raise ArithmeticError("no tangent here")
        return super().tangent()


class Fragile(NeoHookean):
    """Follows increments of at most `limit`."""

    def __init__(self, size: int, limit: float):
        super().__init__(size, 100.0, 0.3)
        self._limit = limit

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        if np.abs(F - np.eye(2)).max(initial=0.0) > self._limit:
            raise InadmissibleDeformation("grains lose their neighbours")
        return super().evaluate(F)
