"""Geometry that moves with the material, step by step."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from . import _dolfinx


class MeshMotion:
    """Moves the nodes of a mesh by a displacement function.

    Attributes:
        displacement: total displacement of the nodes, m: Lagrange of the geometry's degree, which
            is what XDMF can hold.

    Args:
        increment: displacement of one step, in any space on the mesh; or a function of a mixed
            space that begins with it.
        cell: type of the mesh's cells.
        degree: degree of the geometry.
    """

    def __init__(self, increment: fem.Function, cell: str, degree: int):
        self._mesh = increment.function_space.mesh
        self._dim = self._mesh.geometry.dim
        mixed = increment.ufl_shape != (self._dim,)
        self._increment = increment.sub(0) if mixed else increment
        nodes = _dolfinx.lagrange_element(cell, degree, (self._dim,))
        self._nodal = fem.Function(_dolfinx.functionspace(self._mesh, nodes))
        self.displacement = fem.Function(self._nodal.function_space)
        self.displacement.name = "displacement"
        self._dof_of_node = np.empty(len(self._mesh.geometry.x), dtype=np.int64)
        geometry = _dolfinx.geometry_dofmap(self._mesh)
        self._dof_of_node[geometry.ravel()] = _dolfinx.dofmap(self._nodal.function_space).ravel()

    def move(self) -> None:
        """Add the increment to the geometry, ghosts included, and to `displacement`."""
        self._nodal.interpolate(self._increment)
        self._nodal.x.scatter_forward()
        shift = self._nodal.x.array.reshape(-1, self._dim)[self._dof_of_node]
        self._mesh.geometry.x[:, : self._dim] += shift
        self.displacement.x.array[:] += self._nodal.x.array
