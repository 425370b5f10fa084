"""Grain-size distributions: how many grains of which radius."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from . import reproducible


class GrainSizes(Protocol):
    """A distribution that radii can be drawn from."""

    @property
    def smallest(self) -> float:
        """Smallest radius, m."""
        ...

    @property
    def largest(self) -> float:
        """Largest radius, m."""
        ...

    def draw(self, grains: int, dim: int, rng: np.random.Generator) -> np.ndarray:
        """Radii (grains,), m; grains get random places, so that their order does not matter."""
        ...


@dataclass(frozen=True)
class UniformByNumber:
    """As many grains of every radius between two bounds, m (Guo-Zhao table I)."""

    smallest: float
    largest: float

    def __post_init__(self):
        _check_range(self.smallest, self.largest)

    def draw(self, grains: int, dim: int, rng: np.random.Generator) -> np.ndarray:
        """Radii (grains,), m, each on its own."""
        return rng.uniform(self.smallest, self.largest, grains)


@dataclass(frozen=True)
class UniformByVolume:
    """As much volume of every radius between two bounds, m: many small grains, few large ones."""

    smallest: float
    largest: float

    def __post_init__(self):
        _check_range(self.smallest, self.largest)

    def draw(self, grains: int, dim: int, rng: np.random.Generator) -> np.ndarray:
        """Radii (grains,), m; see `_spread`."""
        bounds = np.array([self.smallest, self.largest])
        return _spread(bounds, np.ones(1), -float(dim), grains, rng)


@dataclass(frozen=True)
class SieveCurve:
    """A measured grain-size curve.

    Attributes:
        diameters: (k,) m, k >= 2, of the sieves, increasing.
        passing: (k,) share of the mass that falls through, increasing from 0 to 1. Between two
            sieves it is a straight line over the logarithm of the diameter, as such curves are
            drawn.

    Raises ValueError for a curve that does not increase, or does not go from 0 to 1.
    """

    diameters: Sequence[float]
    passing: Sequence[float]

    def __post_init__(self):
        d, share = np.array(self.diameters, float), np.array(self.passing, float)
        if d.ndim != 1 or d.shape != share.shape or d.size < 2:
            raise ValueError(
                "sieve curve: give at least two sieves, each with its diameter and what passes;"
                f" got {d.size} and {share.size}"
            )
        if not (np.isfinite(d).all() and np.isfinite(share).all() and (d > 0).all()):
            raise ValueError("sieve curve: diameters must be positive and all values finite")
        for name, values in (("diameter", d), ("share that passes", share)):
            falls = np.flatnonzero(np.diff(values) <= 0)
            if len(falls):
                k = falls[0]
                raise ValueError(
                    f"sieve curve: the {name} does not increase from sieve {k + 1} to {k + 2}"
                    f" ({values[k]:g}, {values[k + 1]:g})"
                )
        if share[0] != 0 or share[-1] != 1:
            raise ValueError(
                f"sieve curve: what passes must go from 0 to 1 (100 %), not from {share[0]:g} to"
                f" {share[-1]:g}"
            )
        object.__setattr__(self, "diameters", tuple(d))
        object.__setattr__(self, "passing", tuple(share))

    @property
    def smallest(self) -> float:
        """Smallest radius, m."""
        return self.diameters[0] / 2

    @property
    def largest(self) -> float:
        """Largest radius, m."""
        return self.diameters[-1] / 2

    def draw(self, grains: int, dim: int, rng: np.random.Generator) -> np.ndarray:
        """Radii (grains,), m; see `_spread`."""
        bounds = np.array(self.diameters) / 2
        # straight over ln r: the density of the volume is share / (r ln(b / a)) between a and b
        volume = np.diff(self.passing) / np.diff(reproducible.log(bounds))
        return _spread(bounds, volume, -1.0 - dim, grains, rng)


@dataclass(frozen=True)
class GivenRadii:
    """These radii, m, in this order: packings with the same grains at other places."""

    radii: tuple[float, ...]

    def __post_init__(self):
        radii = np.array(self.radii, float)
        if radii.ndim != 1 or radii.size == 0 or not ((radii > 0) & np.isfinite(radii)).all():
            raise ValueError("given radii must be positive and finite, and one or more")
        object.__setattr__(self, "radii", tuple(radii))

    @property
    def smallest(self) -> float:
        """Smallest radius, m."""
        return min(self.radii)

    @property
    def largest(self) -> float:
        """Largest radius, m."""
        return max(self.radii)

    def draw(self, grains: int, dim: int, rng: np.random.Generator) -> np.ndarray:
        """Radii (grains,), m; ValueError where there are not as many as asked for."""
        if grains != len(self.radii):
            raise ValueError(f"{len(self.radii)} radii are given for {grains} grains")
        return np.array(self.radii)


def _check_range(smallest: float, largest: float) -> None:
    if not 0 < smallest <= largest < np.inf:
        raise ValueError(f"radii: need 0 < smallest <= largest (m), got {smallest} and {largest}")


def _spread(
    bounds: np.ndarray, weights: np.ndarray, power: float, grains: int, rng: np.random.Generator
) -> np.ndarray:
    """Radii (grains,) whose number per radius is weights[k] r^power from bounds[k] to [k + 1].

    One radius is drawn from each of `grains` parts of equal probability: the few large grains,
    which hold much of the volume, would otherwise be two in one packing and none in the next.
    """
    exponent = power + 1.0
    if bounds[0] == bounds[-1]:
        return np.full(grains, bounds[0])
    powers = reproducible.power(bounds, exponent)
    numbers = np.append(0.0, np.cumsum(weights * np.diff(powers) / exponent))
    wanted = numbers[-1] * (np.arange(grains) + rng.uniform(size=grains)) / grains
    k = np.clip(np.searchsorted(numbers, wanted, "right") - 1, 0, len(weights) - 1)
    radii = powers[k] + exponent * (wanted - numbers[k]) / weights[k]
    radii = reproducible.power(radii, 1.0 / exponent)
    return rng.permutation(np.clip(radii, bounds[0], bounds[-1]))


def read_sieve_curve(path) -> SieveCurve:
    """A curve from a CSV file: diameter in mm, what passes in %; a header line is skipped.

    Raises ValueError, in one line that names the file and what is wrong with it.
    """
    try:
        with open(path, encoding="utf-8") as file:
            lines = [line.strip() for line in file]
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise ValueError(f"{path}: cannot read the sieve curve: {reason}") from None
    rows = []
    for number, line in enumerate(lines, 1):
        if not line or line.startswith("#") or (number == 1 and line[0].isalpha()):
            continue
        try:
            diameter, passing = (float(cell) for cell in line.replace(";", ",").split(","))
        except ValueError:
            raise ValueError(
                f"{path}, line {number}: expected 'diameter in mm, passing in %', got '{line}'"
            ) from None
        rows.append((1e-3 * diameter, 1e-2 * passing))
    try:
        return SieveCurve(*(zip(*rows, strict=True) if rows else ((), ())))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
