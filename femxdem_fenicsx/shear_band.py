"""A shear band measured: where it is, how it is inclined, how wide it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import LinearNDInterpolator

ANGLES = np.radians(np.concatenate([np.arange(-80, -9, 2), np.arange(10, 81, 2)]))
LINES, CUTS, SAMPLES = 81, 25, 401
#: Percentile of the strain that stands for what is outside the band.
OUTSIDE = 20


@dataclass(frozen=True)
class ShearBand:
    """A straight band in a plane specimen.

    Attributes:
        width: at half maximum of the strain above what is outside, the median over cuts across
            the band, m.
        angle: to the first axis, degrees, in (-90, 90).
        strain: largest mean along a line, what the line was found by.
        contrast: that over the strain outside.
    """

    width: float
    angle: float
    strain: float
    contrast: float


def measure(x: np.ndarray, strain: np.ndarray) -> ShearBand:
    """The band in a field of deviatoric strain.

    The band is the straight line from one side of the specimen to the other, inclined by 10 to 80
    degrees, along which the mean strain is largest. Cuts normal to it give the width; half maximum
    lies between the cut's peak and the strain outside, the 20th percentile of the specimen's.

    Args:
        x: points (n, 2), m.
        strain: at the points, (n,).

    Raises:
        ValueError: no line and no cut with two flanks, as in a field without a band.
    """
    field = LinearNDInterpolator(x, strain)
    centre, reach = x.mean(axis=0), float(np.ptp(x, axis=0).max())
    along = np.linspace(-reach, reach, SAMPLES)
    offsets = np.linspace(-reach / 2, reach / 2, LINES)
    step, across = offsets[1] - offsets[0], 0.85 * np.ptp(x[:, 0])
    best = max(
        (
            _line(field, centre, along, angle, offset, across)
            for angle in ANGLES
            for offset in offsets
        ),
        key=lambda line: line[0],
    )
    for _ in range(3):  # finer around the best
        step /= 3
        near = [
            (best[1] + 3 * step / reach * i, best[2] + step * j)
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        best = max(
            [best, *(_line(field, centre, along, *place, across) for place in near)],
            key=lambda line: line[0],
        )
    mean, angle, offset = best
    outside = float(np.percentile(strain, OUTSIDE))
    widths = _widths(field, centre, along, angle, offset, outside)
    if mean == -np.inf or not len(widths):
        raise ValueError("no shear band: the strain has no ridge across the specimen")
    return ShearBand(float(np.median(widths)), float(np.degrees(angle)), mean, mean / outside)


def _axes(angle: float) -> tuple[np.ndarray, np.ndarray]:
    tangent = np.array([np.cos(angle), np.sin(angle)])
    return tangent, np.array([-tangent[1], tangent[0]])


def _line(field, centre, along, angle, offset, across) -> tuple[float, float, float]:
    """Mean along a line; -inf for one that does not go so far along the first axis."""
    tangent, normal = _axes(angle)
    values = field(centre + offset * normal + along[:, None] * tangent)
    inside = values[~np.isnan(values)]
    long_enough = len(inside) * (along[1] - along[0]) * tangent[0] > across
    return (float(inside.mean()) if long_enough else -np.inf), angle, offset


def _widths(field, centre, along, angle, offset, outside) -> np.ndarray:
    """Full widths at half maximum of cuts across the band, in its middle three fifths."""
    tangent, normal = _axes(angle)
    values = field(centre + offset * normal + along[:, None] * tangent)
    ends = along[~np.isnan(values)][[0, -1]]
    middle, half = ends.mean(), 0.3 * np.ptp(ends)
    widths = []
    for place in np.linspace(middle - half, middle + half, CUTS):
        cut = field(centre + place * tangent + (offset + along[:, None]) * normal)
        near = np.abs(along) < 0.15 * np.ptp(along)
        peak = np.nanargmax(np.where(near, cut, np.nan))
        above = cut > 0.5 * (cut[peak] + outside)
        flanks = [
            _crossing(along, cut, peak, side, 0.5 * (cut[peak] + outside)) for side in (-1, 1)
        ]
        if above[peak] and None not in flanks:
            widths.append(flanks[1] - flanks[0])
    return np.array(widths)


def _crossing(along, cut, peak: int, side: int, level: float) -> float | None:
    """Where the cut falls below the level, going from its peak to one side; None: it does not."""
    i = peak
    while 0 < i < len(cut) - 1:
        following = cut[i + side]
        if np.isnan(following):
            return None
        if following < level:
            share = (cut[i] - level) / (cut[i] - following)
            return float(along[i] + side * share * (along[1] - along[0]))
        i += side
    return None
