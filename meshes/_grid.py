"""Structured meshes of a rectangle or box: what they share in both dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations
from math import prod

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from femxdem_fenicsx.fem import _dolfinx
from femxdem_fenicsx.fem.elements import Element

#: A quadratic hexahedron has eight nodes of its own, and rank 0 numbers all of them by 32 bits.
MOST_CELLS = 2**31 // 8
#: Wave numbers of the shift of inner nodes along each axis, when a mesh is distorted.
WAVES = np.array([[7, 3, 2], [5, -4, 3], [6, 4, -5]])


def create(
    comm: MPI.Comm, size: tuple[float, ...], counts: tuple[int, ...], element, distortion: float
):
    """Mesh of [0, size] with `counts` cells along each axis, geometry of the element's degree.

    Rank 0 makes it and DOLFINx distributes it, so that every number of ranks sees the same cells
    in the same original order. Simplices halve squares, or cut a cube in six, along the diagonal
    from its first corner to its last (Kuhn's triangulation).
    """
    cells = _cells(counts, element.cell, element.degree)
    nodes = _nodes(counts, element, distortion, cells)
    if comm.rank > 0:
        cells, nodes = cells[:0], nodes[:0]
    scale = np.divide(size, counts)
    return _dolfinx.create_mesh(comm, cells, nodes * scale, element.cell, element.degree)


def _cells(counts: tuple[int, ...], cell: str, degree: int) -> np.ndarray:
    """Nodes of each cell, in DOLFINx' order; cells and nodes go row by row, along x first."""
    strides = np.cumprod([1, *(degree * count + 1 for count in counts[:-1])])
    corners = degree * _lattice([np.arange(count) for count in counts])
    weights = degree * _dolfinx.vertex_weights(cell, degree)
    patterns = [np.rint(weights @ vertices).astype(int) for vertices in _vertices(cell)]
    offsets = np.array(patterns) @ strides
    return ((corners @ strides)[:, None, None] + offsets).reshape(-1, len(weights))


def _vertices(cell: str) -> list[np.ndarray]:
    """Vertices of the cells that fill a unit square or cube, (v, d) each."""
    dim = 2 if cell in ("quadrilateral", "triangle") else 3
    if cell in ("quadrilateral", "hexahedron"):
        return [_lattice([np.arange(2)] * dim)]
    simplices = []
    for order in permutations(range(dim)):
        steps = np.eye(dim, dtype=int)[list(order)]
        simplex = np.vstack([np.zeros(dim, int), np.cumsum(steps, axis=0)])
        if np.linalg.det(steps) < 0:
            simplex[[-2, -1]] = simplex[[-1, -2]]
        simplices.append(simplex)
    return simplices


def _nodes(counts: tuple[int, ...], element: Element, distortion: float, cells) -> np.ndarray:
    """Coordinates of the nodes in units of cells, (n, d); edges of cells are straight."""
    dim = len(counts)
    x = _lattice([np.arange(count + 1.0) for count in counts])
    inside = ((x > 0) & (x < counts)).all(axis=1)
    phases = x @ WAVES[:dim, :dim].T
    waves = [np.cos(phases[:, k]) if k % 2 else np.sin(phases[:, k]) for k in range(dim)]
    x += distortion * inside[:, None] * np.column_stack(waves)
    vertices = x[_cells(counts, element.cell, 1)]
    nodes = np.empty((cells.max() + 1, dim))
    nodes[cells] = _dolfinx.vertex_weights(element.cell, element.degree) @ vertices
    return nodes


def _lattice(axes: list[np.ndarray]) -> np.ndarray:
    """Points of a grid, (n, d), row by row: x goes fastest."""
    return np.stack(np.meshgrid(*reversed(axes), indexing="ij")[::-1], -1).reshape(-1, len(axes))


def sides(mesh, size: tuple[float, ...], tags: Mapping[int, tuple[int, int]]) -> dmesh.MeshTags:
    """Boundary facets with a tag for each side; a side is (axis, 0 or 1 for its low or high end).

    Call it before the mesh moves; the tags stay right afterwards.
    """
    tolerance = 1e-9 * max(size)
    facet_dim = len(size) - 1
    facets, values = [], []
    for tag, (axis, end) in tags.items():
        found = dmesh.locate_entities_boundary(
            mesh, facet_dim, lambda x, a=axis, p=end * size[axis]: np.abs(x[a] - p) < tolerance
        )
        facets.append(found)
        values.append(np.full(len(found), tag, dtype=np.int32))
    facets, values = np.concatenate(facets), np.concatenate(values)
    order = np.argsort(facets)
    return dmesh.meshtags(mesh, facet_dim, facets[order], values[order])


def vertex_near(mesh, *point: float) -> np.ndarray:
    """The mesh vertex nearest to a point as a local vertex number; empty on ranks without it.

    Of equally near vertices it is the first by x, then by y, then by z.
    """
    dim = len(point)

    def nearest(x):
        distance = np.linalg.norm(x[:dim].T - point, axis=1).round(12)
        order = np.lexsort([*x[dim - 1 :: -1], distance])[:1]
        own = [(distance[i], *x[:dim, i]) for i in order]
        _, *at = min(found for rank in mesh.comm.allgather(own) for found in rank)
        return np.linalg.norm(x[:dim].T - at, axis=1) < 1e-12

    return dmesh.locate_entities(mesh, 0, nearest)


def check(
    shape: str, size: tuple[float, ...], counts: tuple[int, ...], distortion: float, limit: float
) -> None:
    """Raise ValueError for sizes, numbers of cells and distortions that make no mesh."""
    if not (np.isfinite(size).all() and min(size) > 0):
        sizes = " x ".join(f"{length} m" for length in size)
        every = "both" if len(size) == 2 else "all"
        raise ValueError(f"{shape} of {sizes}: {every} sizes must be positive")
    if min(counts) < 1:
        cells = " x ".join(map(str, counts))
        raise ValueError(f"{shape} of {cells} cells: there must be one at least each way")
    if prod(counts) > MOST_CELLS:
        cells = " x ".join(map(str, counts))
        raise ValueError(f"{shape} of {cells} cells: more than {MOST_CELLS} cannot be numbered")
    if not 0 <= distortion < limit:
        raise ValueError(f"mesh distortion {distortion}: it must be in [0, {limit})")
