"""A box-shaped specimen in a structured mesh."""

from __future__ import annotations

from dolfinx import mesh as dmesh
from mpi4py import MPI

from femxdem_fenicsx.fem.elements import Element

from . import _grid
from ._grid import vertex_near

__all__ = ["BACK", "BOTTOM", "FRONT", "LEFT", "RIGHT", "TOP", "box", "sides", "vertex_near"]

LEFT, RIGHT, FRONT, BACK, BOTTOM, TOP = 1, 2, 3, 4, 5, 6


def box(
    comm: MPI.Comm,
    size: tuple[float, float, float],
    cells: tuple[int, int, int],
    element: Element,
    distortion: float = 0.0,
):
    """Mesh of [0, size] along x, y and z whose geometry has the degree of `element`.

    Every number of ranks sees the same cells in the same original order.

    Args:
        comm: communicator of the mesh.
        size: along x, y and z, m.
        cells: their number along x, y and z; of cubes of six tetrahedra for T4 and T10.
        element: what the mesh is for.
        distortion: largest shift of an inner node along an axis, as a fraction of a cell's size
            (below 0.2, or tetrahedra could fold). The boundary stays plane, edges straight.

    Raises:
        ValueError: an element of another dimension, sizes that are not positive, fewer than one
            cell, a distortion out of range.
    """
    element.check_dim(3)
    _grid.check("box", tuple(size), tuple(cells), distortion, 0.2)
    return _grid.create(comm, tuple(size), tuple(cells), element, distortion)


def sides(mesh, size: tuple[float, float, float]) -> dmesh.MeshTags:
    """Boundary facets of a box: LEFT and RIGHT (x), FRONT and BACK (y), BOTTOM and TOP (z).

    Call it before the mesh moves; the tags stay right afterwards.
    """
    tags = {LEFT: (0, 0), RIGHT: (0, 1), FRONT: (1, 0), BACK: (1, 1), BOTTOM: (2, 0), TOP: (2, 1)}
    return _grid.sides(mesh, size, tags)
