"""What the increments so far say of the next one."""

from __future__ import annotations

from collections.abc import Callable

import h5py
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from .learnt import cell_rows, from_cell_rows

#: Behind the peak, a change goes on if its error as a forecast was this share of that of none.
CLEARLY = 0.7
#: Before it, no less than this share of a change goes on.
LEAST_SHARE = 0.5


class Forecast:
    """The last increment per unit of load, and a share of its change from the one before.

    While the reactions are larger than ever, up to the peak, it is the share of the change before
    that would have foretold the last change best, in the sense of least squares, but no less than
    half. Behind the peak the grains rearrange; the change is then taken along where the one before
    would have foretold the last step clearly better than no change.

    Attributes:
        last: size and increment (owned dofs), m, of the last step; None before the first.
        known: whether there is one.
        change: of the increment per unit of load, m, owned dofs.
        share: of it that is taken along.
        largest_reactions: RNORM, the largest of all steps so far, N.

    Args:
        u: displacement of the step; lends its space, and its values for a moment.
        size: number of owned dofs.
        norms: Euclidean norms, over all ranks, of such arrays.
    """

    def __init__(self, u: fem.Function, size: int, norms: Callable[..., list[float]]):
        self._u, self._norms = u, norms
        self.last: tuple[float, np.ndarray] | None = None
        self.change, self.share = np.zeros(size), 0.0
        self.largest_reactions = 0.0

    @property
    def known(self) -> bool:
        return self.last is not None

    def increment(self, step: float) -> np.ndarray:
        """Of the next step, (owned dofs,), m; `step` is its size on the load path."""
        last, increment = self.last
        forecast = step / last * increment
        return forecast + step * self.share * self.change if self.share else forecast

    def note(self, step: float, increment: np.ndarray, reactions: float) -> None:
        """A step of size `step` has been accepted with this increment, m, and this RNORM, N."""
        before_the_peak = reactions > self.largest_reactions
        self.largest_reactions = max(reactions, self.largest_reactions)
        if self.last is not None:
            last, before = self.last
            change = increment / step - before / last
            self.share = self._share(change, before_the_peak)
            self.change = change
        self.last = (step, increment.copy())

    def _share(self, change: np.ndarray, before_the_peak: bool) -> float:
        """Of this change, that is taken along in the next step."""
        new, old, error = self._norms(change, self.change, change - self.change)
        if not before_the_peak:
            return float(error < CLEARLY * new)
        if old == 0.0:
            return 1.0
        best = (new**2 + old**2 - error**2) / (2 * old**2)  # change . old / old . old
        return min(max(best, LEAST_SHARE), 1.0)

    def save(self, group: h5py.Group, cells: slice) -> None:
        """Write it into an HDF5 group: a row per cell of `cells`."""
        step, increment = self.last or (0.0, np.zeros_like(self.change))
        group["increment"] = cell_rows(self._u, increment)[cells]
        group["step"] = np.full(cells.stop, step)
        group["change"] = cell_rows(self._u, self.change)[cells]
        group["share_of_change"] = np.full(cells.stop, self.share)
        group["largest_reactions"] = np.full(cells.stop, self.largest_reactions)

    def load(self, group: h5py.Group, comm: MPI.Comm) -> None:
        """Read back what `save` wrote: a row per cell of this rank, ghosts included.

        A file of the first format has no change; of that, the first program to write the second
        kept whether it goes on.
        """

        def number(name: str) -> float:  # a rank may have no cells
            return comm.allreduce(float(group[name][()].max(initial=0.0)), MPI.MAX)

        increment, step = from_cell_rows(self._u, group["increment"][()]), number("step")
        self.last = (step, increment) if step > 0 else None
        if "change" in group:
            self.change = from_cell_rows(self._u, group["change"][()])
            older = "change_goes_on" in group
            self.share = number("change_goes_on" if older else "share_of_change")
            self.largest_reactions = 0.0 if older else number("largest_reactions")
