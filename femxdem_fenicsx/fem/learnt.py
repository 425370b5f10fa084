"""What the solver has learnt about the problem, and takes from one load step to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import h5py
import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from . import _dolfinx
from .anderson import Anderson


@dataclass
class _Known:
    """At some moment: whether a matrix is there, whether Anderson holds on to it, (dX, dG)."""

    assembled: bool = False
    factorised: bool = False
    differences: Sequence[tuple[PETSc.Vec, PETSc.Vec]] = ()


class Learnt:
    """The Jacobian computed last, and Anderson's differences; as they are, and as they were kept.

    A step that is given up may have replaced them: what a checkpoint holds is what was kept at the
    end of the last accepted one. Factors are not kept: they are computed from the matrix anew.

    Attributes:
        assembled: whether there is a Jacobian.

    Args:
        snes: solver. matrix: its Jacobian. u: lends its space, and its values for a moment.
    """

    def __init__(self, snes: PETSc.SNES, matrix: PETSc.Mat, u: fem.Function):
        self._snes, self._matrix, self._u = snes, matrix, u
        self._kept, self._known = None, _Known()
        self.assembled = False

    @property
    def _anderson(self) -> Anderson | None:
        context = self._snes.getPythonContext() if self._snes.getType() == "python" else None
        return context if isinstance(context, Anderson) else None

    def renew(self) -> None:
        """A Jacobian has been computed."""
        self.assembled = True
        # MUMPS orders by the values of the first matrix: factors shall depend on this one alone
        self._snes.getKSP().reset()

    def forget(self) -> None:
        """Know nothing; what was kept stays."""
        self.assembled = False
        if self._anderson:
            self._anderson.forget()

    def keep(self) -> None:
        """Keep what is known now."""
        self._known = _Known(self.assembled)
        if self.assembled:
            if self._kept is None:
                self._kept = self._matrix.duplicate()
            self._matrix.copy(self._kept, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        if self._anderson and self._anderson.keep:
            self._known.factorised = self._anderson.factorised
            self._known.differences = list(self._anderson.differences)

    def save(self, group: h5py.Group) -> None:
        """Write what was kept: a row per owned cell. The values of u are zero afterwards."""
        known, cells = self._known, _dolfinx.number_of_cells(self._u.function_space.mesh)[0]
        if not known.assembled:
            return
        group["jacobian"] = _dolfinx.cell_matrices(self._kept, self._u.function_space)
        group["jacobian_in_use"] = np.full(cells, known.factorised)
        vectors = [vector.array_r for pair in known.differences for vector in pair]
        rows = [cell_rows(self._u, vector)[:cells] for vector in vectors]
        if rows:
            group["differences"] = np.stack(rows, axis=1)

    def load(self, group: h5py.Group) -> None:
        """Read back what `save` wrote: a row per cell of this rank, ghosts included."""
        self.forget()
        if "jacobian" in group:
            space, anderson = self._u.function_space, self._anderson
            _dolfinx.set_cell_matrices(self._matrix, space, group["jacobian"][()])
            self._snes.getKSP().setOperators(self._matrix)
            self.renew()
            if anderson:
                in_use = bool(group["jacobian_in_use"][()].all())  # some ranks may have no cell
                anderson.factorised = space.mesh.comm.allreduce(in_use, MPI.LAND)
                anderson.differences = self._pairs(group)
        self.keep()

    def _pairs(self, group: h5py.Group) -> list[tuple[PETSc.Vec, PETSc.Vec]]:
        if "differences" not in group:
            return []
        vectors = []
        for rows in np.moveaxis(group["differences"][()], 1, 0):
            vectors.append(self._matrix.createVecRight())
            vectors[-1].array[:] = from_cell_rows(self._u, rows)
        return list(zip(vectors[::2], vectors[1::2], strict=True))


def cell_rows(u: fem.Function, owned: np.ndarray) -> np.ndarray:
    """Values of owned dofs by cell, ghosts included, (c, k); u's are zero afterwards."""
    u.x.array[: len(owned)] = owned
    u.x.scatter_forward()
    rows = _dolfinx.cell_values(u)
    u.x.array[:] = 0.0
    return rows


def from_cell_rows(u: fem.Function, rows: np.ndarray) -> np.ndarray:
    """Owned dofs of what `cell_rows` gave; u's values are zero afterwards."""
    _dolfinx.set_cell_values(u, rows)
    index_map, block = u.function_space.dofmap.index_map, u.function_space.dofmap.index_map_bs
    owned = u.x.array[: index_map.size_local * block].copy()
    u.x.array[:] = 0.0
    return owned
