"""A bar of three elements of which the middle one softens: faster than the others can unload."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from femxdem_fenicsx.fem.stepping import LoadStepping, Outcome, Position, walk
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


def resumed(
    folder: Path, load: float, stepping: LoadStepping, wanted: Callable[[Position], bool]
) -> tuple[Position, Outcome, Outcome, Specimen, Specimen]:
    """A run, and one that goes on from where the first was the first time that it was wanted there.

    The position, and how both ended, with their bars.
    """
    whole, again, positions = bar(), bar(), []
    with h5py.File(folder / "state.h5", "w") as file:

        def between(position: Position) -> None:
            if wanted(position) and not positions:
                whole.problem.save(file.create_group("problem"))
                whole.law.save(file.create_group("law"))
                positions.append(position)

        one = walk(whole.problem, whole.compress, load, stepping, between=between)
        again.problem.load(file["problem"])
        again.law.load(file["law"])
    two = walk(again.problem, again.compress, load, stepping, start=positions[0])
    return positions[0], one, two, whole, again
