"""The quadrature points that a rank owns, in the order in which a law sees them."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem

from . import _dolfinx
from .elements import Element


class QuadraturePoints:
    """Quadrature points of the cells that this rank owns: cell by cell, then point by point.

    Ghost cells have no points here: the rank that owns them computes them.

    Attributes:
        mesh: the mesh.
        element: the element whose points these are.
        cells: owned cells, local numbers, (c,).
        size: number of points on this rank.
        index: number of each point in the whole mesh, (size,). It depends on the order in which
            the cells were given to the mesh, not on the number of ranks: seeds follow from it.
    """

    def __init__(self, mesh, element: Element):
        self.mesh = mesh
        self.element = element
        self.cells = np.arange(_dolfinx.number_of_cells(mesh)[0], dtype=np.int32)
        self.size = len(self.cells) * element.points_per_cell
        original = np.asarray(mesh.topology.original_cell_index, dtype=np.int64)[self.cells]
        per_cell = np.arange(element.points_per_cell)
        self.index = (original[:, None] * element.points_per_cell + per_cell).ravel()
        self.reference, self._weights = _dolfinx.quadrature_rule(
            element.cell, element.quadrature_degree
        )
        self._x = fem.Expression(ufl.SpatialCoordinate(mesh), self.reference)
        self._det = fem.Expression(abs(ufl.JacobianDeterminant(mesh)), self.reference)

    def evaluate(self, expression: fem.Expression, shape: tuple[int, ...]) -> np.ndarray:
        """Values at the points, (size, *shape), of an expression compiled at `reference`."""
        values = _dolfinx.evaluate(expression, self.mesh, self.cells, shape)
        return values.reshape(self.size, *shape)

    def function(self, shape: tuple[int, ...]) -> fem.Function:
        """Quadrature function with values of the given shape."""
        element = self.element
        quadrature = _dolfinx.quadrature_element(element.cell, element.quadrature_degree, shape)
        return fem.Function(_dolfinx.functionspace(self.mesh, quadrature))

    def rows(self, function: fem.Function) -> np.ndarray:
        """Where a quadrature function of any shape has the values at these points, (size,).

        Rows of ``function.x.array.reshape(-1, components)``.
        """
        return _dolfinx.dofmap(function.function_space)[: len(self.cells)].ravel()

    def coordinates(self) -> np.ndarray:
        """Where the points are in the present geometry, (size, gdim), m."""
        return self.evaluate(self._x, (self.mesh.geometry.dim,))

    def volumes(self) -> np.ndarray:
        """Weight times Jacobian determinant in the present geometry, (size,), m^2 in 2D."""
        return self.evaluate(self._det, ()) * np.tile(self._weights, len(self.cells))

    def cell_means(self, values: np.ndarray) -> np.ndarray:
        """Volume-weighted mean over each owned cell: (size, ...) -> (c, ...)."""
        weights = self.volumes().reshape(len(self.cells), self.element.points_per_cell)
        weights = weights / weights.sum(axis=1, keepdims=True)
        by_cell = values.reshape(*weights.shape, *values.shape[1:])
        return np.einsum("cq,cq...->c...", weights, by_cell)

    def cell_corners(self) -> np.ndarray:
        """Corners of each owned cell in the present geometry, in order around it, (c, k, 2).

        Raises ValueError for a mesh in 3D, whose cells have no order around them.
        """
        if self.mesh.geometry.dim != 2:
            raise ValueError("corners in order around a cell: there is such an order in 2D alone")
        corners = [0, 1, 3, 2] if self.element.cell == "quadrilateral" else [0, 1, 2]
        nodes = _dolfinx.geometry_dofmap(self.mesh)[: len(self.cells)][:, corners]
        return self.mesh.geometry.x[nodes][..., :2]

    def gather(self, *by_cell: np.ndarray) -> tuple[np.ndarray, ...] | None:
        """Arrays (c, ...) of owned cells, put together for the whole mesh on rank 0; else None.

        In the cells' original order, which is the same for every number of ranks.
        """
        original = np.asarray(self.mesh.topology.original_cell_index)[self.cells]
        parts = self.mesh.comm.gather((original, by_cell))
        if parts is None:
            return None
        order = np.argsort(np.concatenate([numbers for numbers, _ in parts]))
        columns = zip(*(arrays for _, arrays in parts), strict=True)
        return tuple(np.concatenate(column)[order] for column in columns)
