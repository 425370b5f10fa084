"""A rectangular specimen in a structured mesh."""

from __future__ import annotations

from dolfinx import mesh as dmesh
from mpi4py import MPI

from femxdem_fenicsx.fem.elements import Element

from . import _grid
from ._grid import vertex_near

__all__ = ["BOTTOM", "LEFT", "RIGHT", "TOP", "rectangle", "sides", "vertex_near"]

LEFT, RIGHT, BOTTOM, TOP = 1, 2, 3, 4


def rectangle(
    comm: MPI.Comm,
    width: float,
    height: float,
    nx: int,
    ny: int,
    element: Element,
    distortion: float = 0.0,
):
    """Mesh of [0, width] x [0, height] whose geometry has the degree of `element`.

    Every number of ranks sees the same cells in the same original order. Q8 has the geometry of
    nine nodes: only that one follows its motion exactly.

    Args:
        comm: communicator of the mesh.
        width: size along x, m.
        height: size along y, m.
        nx: number of cells along x; of pairs of triangles for T6.
        ny: the same along y.
        element: what the mesh is for.
        distortion: largest shift of an inner node, as a fraction of a cell's size (below 0.4).
            The boundary stays straight and the edges of cells too.

    Raises:
        ValueError: an element of another dimension, sizes that are not positive, fewer than one
            cell, a distortion out of range.
    """
    element.check_dim(2)
    _grid.check("rectangle", (width, height), (nx, ny), distortion, 0.4)
    return _grid.create(comm, (width, height), (nx, ny), element, distortion)


def sides(mesh, width: float, height: float) -> dmesh.MeshTags:
    """Boundary facets of a rectangle, tagged LEFT, RIGHT, BOTTOM and TOP.

    Call it before the mesh moves; the tags stay right afterwards.
    """
    tags = {LEFT: (0, 0), RIGHT: (0, 1), BOTTOM: (1, 0), TOP: (1, 1)}
    return _grid.sides(mesh, (width, height), tags)
