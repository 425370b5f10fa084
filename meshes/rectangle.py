"""A rectangular specimen in a structured mesh."""

from __future__ import annotations

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from femxdem_fenicsx.fem import _dolfinx
from femxdem_fenicsx.fem.elements import Element

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

    Rank 0 makes it and DOLFINx distributes it, so that every number of ranks sees the same cells
    in the same original order. Q8 has the geometry of nine nodes: only that one follows its motion
    exactly.

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
        ValueError: sizes that are not positive, fewer than one cell, a distortion out of range.
    """
    if not (np.isfinite([width, height]).all() and width > 0 and height > 0):
        raise ValueError(f"rectangle of {width} m x {height} m: both sizes must be positive")
    if nx < 1 or ny < 1:
        raise ValueError(f"rectangle of {nx} x {ny} cells: there must be one at least each way")
    if not 0 <= distortion < 0.4:
        raise ValueError(f"mesh distortion {distortion}: it must be in [0, 0.4)")
    cells, nodes = _cells(nx, ny, element), _nodes(nx, ny, element.degree, distortion)
    if comm.rank > 0:
        cells, nodes = cells[:0], nodes[:0]
    scale = [width / nx, height / ny]
    return _dolfinx.create_mesh(comm, cells, nodes * scale, element.cell, element.degree)


def _cells(nx: int, ny: int, element: Element) -> np.ndarray:
    """Nodes of each cell, in DOLFINx' order: vertices, edges, inside."""
    columns = element.degree * nx + 1
    j, i = np.mgrid[0:ny, 0:nx] * element.degree
    corner = (j * columns + i).reshape(-1, 1)
    # offsets (right, up) of a cell's nodes from its lower left corner
    if element.degree == 1:
        patterns = [[(0, 0), (1, 0), (0, 1), (1, 1)]]
    elif element.cell == "quadrilateral":
        patterns = [[(0, 0), (2, 0), (0, 2), (2, 2), (1, 0), (0, 1), (2, 1), (1, 2), (1, 1)]]
    else:  # edges opposite to vertices 0, 1, 2
        patterns = [
            [(0, 0), (2, 0), (2, 2), (2, 1), (1, 1), (1, 0)],
            [(0, 0), (2, 2), (0, 2), (1, 2), (0, 1), (1, 1)],
        ]
    offsets = np.array([[up * columns + right for right, up in pattern] for pattern in patterns])
    return (corner[:, :, None] + offsets).reshape(-1, offsets.shape[1])


def _nodes(nx: int, ny: int, degree: int, distortion: float) -> np.ndarray:
    """Coordinates of the nodes, row by row, in units of cells."""
    y, x = np.mgrid[0 : ny + 1, 0 : nx + 1].astype(float)
    inside = (x > 0) & (x < nx) & (y > 0) & (y < ny)
    x, y = (
        x + distortion * inside * np.sin(7 * x + 3 * y),
        y + distortion * inside * np.cos(5 * x - 4 * y),
    )
    if degree == 2:
        x, y = _with_midpoints(x), _with_midpoints(y)
    return np.column_stack([x.ravel(), y.ravel()])


def _with_midpoints(a: np.ndarray) -> np.ndarray:
    fine = np.empty((2 * a.shape[0] - 1, 2 * a.shape[1] - 1))
    fine[::2, ::2] = a
    fine[::2, 1::2] = 0.5 * (a[:, :-1] + a[:, 1:])
    fine[1::2, ::2] = 0.5 * (fine[:-1:2, ::2] + fine[2::2, ::2])
    fine[1::2, 1::2] = 0.5 * (fine[1::2, :-1:2] + fine[1::2, 2::2])
    return fine


def sides(mesh, width: float, height: float) -> dmesh.MeshTags:
    """Boundary facets of a rectangle, tagged LEFT, RIGHT, BOTTOM and TOP.

    Call it before the mesh moves; the tags stay right afterwards.
    """
    axis_and_position = {LEFT: (0, 0.0), RIGHT: (0, width), BOTTOM: (1, 0.0), TOP: (1, height)}
    tolerance = 1e-9 * max(width, height)
    facets, tags = [], []
    for tag, (axis, position) in axis_and_position.items():
        found = dmesh.locate_entities_boundary(
            mesh, 1, lambda x, a=axis, p=position: np.abs(x[a] - p) < tolerance
        )
        facets.append(found)
        tags.append(np.full(len(found), tag, dtype=np.int32))
    facets, tags = np.concatenate(facets), np.concatenate(tags)
    order = np.argsort(facets)
    return dmesh.meshtags(mesh, 1, facets[order], tags[order])


def vertex_near(mesh, x: float, y: float) -> np.ndarray:
    """The mesh vertex nearest to (x, y) as a local vertex number; empty on ranks without it.

    Of equally near vertices it is the first by x, then by y.
    """

    def nearest(points):
        distance = np.hypot(points[0] - x, points[1] - y).round(12)
        order = np.lexsort([points[1], points[0], distance])[:1]
        own = [(distance[i], points[0][i], points[1][i]) for i in order]
        _, at_x, at_y = min(found for rank in mesh.comm.allgather(own) for found in rank)
        return np.hypot(points[0] - at_x, points[1] - at_y) < 1e-12

    return dmesh.locate_entities(mesh, 0, nearest)
