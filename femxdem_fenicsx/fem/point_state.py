"""What a weak form remembers at the quadrature points from one step to the next."""

from __future__ import annotations

import h5py
import numpy as np
import ufl
from dolfinx import fem

from .quadrature_points import QuadraturePoints


class PointState:
    """A quadrature function that takes the value of an expression when the step is committed.

    The expression follows u, so that there is no trial to discard.

    Attributes:
        committed: the value at the start of the step, as a UFL tensor.
        name: in files.

    Args:
        name: in files.
        points: where it is kept.
        shape: of a value, of rank 2 or 3.
    """

    def __init__(self, name: str, points: QuadraturePoints, shape: tuple[int, ...]):
        self.name, self._points, self._shape = name, points, shape
        self._function = points.function((shape[0], int(np.prod(shape[1:]))))
        self._rows = points.rows(self._function)
        self.committed = _shaped(self._function, shape)
        self._next: fem.Expression | None = None

    def follow(self, expression) -> None:
        """Set the UFL expression that is the value at the end of the step."""
        self._next = fem.Expression(expression, self._points.reference)

    @property
    def values(self) -> np.ndarray:
        """Committed values (size, *shape)."""
        return self._table[self._rows].reshape(len(self._rows), *self._shape)

    @property
    def _table(self) -> np.ndarray:
        return self._function.x.array.reshape(-1, int(np.prod(self._shape)))

    def commit(self) -> None:
        """Take the value at the present u, on the geometry of the start of the step."""
        self._set(self._points.evaluate(self._next, self._shape))

    def save(self, group: h5py.Group) -> None:
        """Write the committed values into an HDF5 group."""
        group.create_dataset(self.name, data=self.values)

    def load(self, group: h5py.Group) -> None:
        """Read back, bit for bit, what `save` wrote; ValueError for another shape."""
        if group[self.name].shape != self.values.shape:
            raise ValueError(
                f"{group.file.filename}: {self.name} has shape {group[self.name].shape}, this mesh "
                f"has {self.values.shape}"
            )
        self._set(group[self.name][...])

    def _set(self, values: np.ndarray) -> None:
        # no ghost has a point here, and none is assembled
        self._table[self._rows] = values.reshape(len(self._rows), self._table.shape[1])


def _shaped(matrix, shape: tuple[int, ...]):
    """A matrix (p, q r) as a tensor (p, q, r): DOLFINx 0.5 has no functions of that rank."""
    if len(shape) == 2:
        return matrix
    rows, columns, depth = shape
    return ufl.as_tensor(
        [
            [[matrix[i, j * depth + k] for k in range(depth)] for j in range(columns)]
            for i in range(rows)
        ]
    )
