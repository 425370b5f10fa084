"""The box's volume, sides and corners, for all elements in 3D."""

import numpy as np
import pytest
from mpi4py import MPI

from femxdem_fenicsx.fem import _dolfinx
from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from meshes.box import BACK, BOTTOM, FRONT, LEFT, RIGHT, TOP, box, sides, vertex_near

WORLD = MPI.COMM_WORLD
SIZE, CELLS = (0.05, 0.06, 0.1), (2, 3, 4)


@pytest.mark.parametrize("name, per_side", [("H8", 1), ("H27", 1), ("T4", 2), ("T10", 2)])
@pytest.mark.parametrize("distortion", [0.0, 0.19])
def test_cells_fill_the_box_and_sides_have_their_facets(name, per_side, distortion):
    mesh = box(WORLD, SIZE, CELLS, element(name), distortion)
    points = QuadraturePoints(mesh, element(name))
    volumes = points.volumes()
    assert volumes.sum() == pytest.approx(3e-4, rel=1e-12)
    assert volumes.min() > 0
    x = points.coordinates()
    assert x.min() > 0 and (x.max(axis=0) < SIZE).all()
    # the first moment too: nodes inside cells are where they belong
    np.testing.assert_allclose(volumes @ x, 3e-4 * np.array(SIZE) / 2, rtol=1e-12)
    tags = sides(mesh, SIZE)
    counts = [len(tags.find(side)) for side in (LEFT, RIGHT, FRONT, BACK, BOTTOM, TOP)]
    assert counts == [per_side * n for n in (12, 12, 8, 8, 6, 6)]


def test_distorted_edges_of_quadratic_tetrahedra_stay_straight():
    mesh = box(WORLD, SIZE, CELLS, element("T10"), 0.19)
    nodes = mesh.geometry.x[_dolfinx.geometry_dofmap(mesh)]
    for middle, (a, b) in enumerate([(2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)], start=4):
        np.testing.assert_allclose(nodes[:, middle], (nodes[:, a] + nodes[:, b]) / 2, atol=1e-15)


def test_vertex_near_a_point_is_one_vertex_even_between_several():
    mesh = box(WORLD, (1.0, 1.0, 1.0), (1, 1, 1), element("H8"))
    vertex = vertex_near(mesh, 0.5, 0.5, 0.0)
    assert len(vertex) == 1
    assert np.array_equal(vertex, vertex_near(mesh, 0.0, 0.0, 0.0))
    assert not np.array_equal(vertex, vertex_near(mesh, 1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "size, cells, kind, distortion, message",
    [
        ((1.0, 0.0, 1.0), (1, 1, 1), "H8", 0.0, "all sizes must be positive"),
        ((1.0, 1.0, np.inf), (1, 1, 1), "H8", 0.0, "all sizes must be positive"),
        ((1.0, 1.0, 1.0), (1, 1, 0), "H8", 0.0, "one at least"),
        ((1.0, 1.0, 1.0), (2, 2, 2), "T4", 0.2, "mesh distortion"),
        ((1.0, 1.0, 1.0), (1, 1, 1), "Q4", 0.0, "Q4 is for 2D"),
    ],
)
def test_impossible_boxes_are_refused(size, cells, kind, distortion, message):
    with pytest.raises(ValueError, match=message):
        box(WORLD, size, cells, element(kind), distortion)


def test_there_are_no_corners_around_a_cell_in_3d():
    points = QuadraturePoints(box(WORLD, SIZE, CELLS, element("H8")), element("H8"))
    with pytest.raises(ValueError, match="in 2D alone"):
        points.cell_corners()
