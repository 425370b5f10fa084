"""A bar of three elements of which the middle one softens: faster than the others can unload."""

from __future__ import annotations

import numpy as np

from femxdem_fenicsx.law import Softening
from tests.fem.specimen import HEIGHT, Specimen

E, K0 = 100.0, 1e-4
PEAK = K0  # axial strain of the bar there


def bar(cells: tuple[int, int] = (1, 3)) -> Specimen:
    def law(points):
        y = points.coordinates()[:, 1]
        weak = np.abs(y - HEIGHT / 2) < HEIGHT / 6
        return Softening(points.size, E, 0.0, np.where(weak, K0, 10 * K0))

    return Specimen(
        law, name="Q4", formulation="small", cells=cells, distortion=0.0, tolerance=1e-6,
        max_iterations=10,
    )  # fmt: skip
