"""What the increments so far say of the next one."""

from __future__ import annotations

from collections.abc import Callable

import h5py
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from .learnt import cell_rows, from_cell_rows

#: A change of the increment goes on if its error as a forecast was this share of that of none.
CLEARLY = 0.7


class Forecast:
    """The last increment per unit of load, and its change from the one before.

    The change is taken to go on where the change before it would have foretold the last step
    clearly better than no change: up to the peak it does, behind it the grains rearrange.

    Attributes:
        last: size and increment (owned dofs), m, of the last step; None before the first.
        known: whether there is one.
        change: of the increment per unit of load, m, owned dofs.
        goes_on: whether it is taken along.

    Args:
        u: displacement of the step; lends its space, and its values for a moment.
        size: number of owned dofs.
        norms: Euclidean norms, over all ranks, of such arrays.
    """

    def __init__(self, u: fem.Function, size: int, norms: Callable[..., list[float]]):
        self._u, self._norms = u, norms
        self.last: tuple[float, np.ndarray] | None = None
        self.change, self.goes_on = np.zeros(size), False

    @property
    def known(self) -> bool:
        return self.last is not None

    def increment(self, step: float) -> np.ndarray:
        """Of the next step, (owned dofs,), m; `step` is its size on the load path."""
        last, increment = self.last
        forecast = step / last * increment
        return forecast + step * self.change if self.goes_on else forecast

    def note(self, step: float, increment: np.ndarray) -> None:
        """A step of size `step` has been accepted with this increment."""
        if self.last is not None:
            last, before = self.last
            change = increment / step - before / last
            constant, linear = self._norms(change, change - self.change)
            self.change, self.goes_on = change, linear < CLEARLY * constant
        self.last = (step, increment.copy())

    def save(self, group: h5py.Group, cells: slice) -> None:
        """Write it into an HDF5 group: a row per cell of `cells`."""
        step, increment = self.last or (0.0, np.zeros_like(self.change))
        group["increment"] = cell_rows(self._u, increment)[cells]
        group["step"] = np.full(cells.stop, step)
        group["change"] = cell_rows(self._u, self.change)[cells]
        group["change_goes_on"] = np.full(cells.stop, self.goes_on)

    def load(self, group: h5py.Group, comm: MPI.Comm) -> None:
        """Read back what `save` wrote: a row per cell of this rank, ghosts included."""
        increment = from_cell_rows(self._u, group["increment"][()])
        step = float(group["step"][0]) if len(group["step"]) else 0.0
        step = comm.allreduce(step, MPI.MAX)
        self.last = (step, increment) if step > 0 else None
        if "change" in group:  # not in the first format
            self.change = from_cell_rows(self._u, group["change"][()])
            goes_on = bool(group["change_goes_on"][()].any())
            self.goes_on = comm.allreduce(goes_on, MPI.LOR)
