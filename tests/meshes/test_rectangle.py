"""The rectangle's area, sides and corners, for all elements."""

import numpy as np
import pytest
from mpi4py import MPI

from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from meshes.rectangle import BOTTOM, LEFT, RIGHT, TOP, rectangle, sides, vertex_near

WORLD = MPI.COMM_WORLD


@pytest.mark.parametrize("name", ["Q4", "Q8", "Q9", "T6"])
@pytest.mark.parametrize("distortion", [0.0, 0.3])
def test_cells_fill_the_rectangle_and_sides_have_their_facets(name, distortion):
    mesh = rectangle(WORLD, 0.05, 0.1, 3, 4, element(name), distortion)
    points = QuadraturePoints(mesh, element(name))
    volumes = points.volumes()
    assert volumes.sum() == pytest.approx(0.005, rel=1e-13)
    assert volumes.min() > 0
    x = points.coordinates()
    assert x.min() > 0 and (x.max(axis=0) < [0.05, 0.1]).all()
    # the first moment too: nodes inside cells are where they belong
    assert volumes @ x[:, 0] == pytest.approx(0.005 * 0.025, rel=1e-12)
    tags = sides(mesh, 0.05, 0.1)
    assert [len(tags.find(side)) for side in (LEFT, RIGHT, BOTTOM, TOP)] == [4, 4, 3, 3]


def test_vertex_near_a_point_is_one_vertex_even_between_two():
    mesh = rectangle(WORLD, 1.0, 2.0, 3, 4, element("Q8"))
    assert len(vertex_near(mesh, 0.5, 0.0)) == 1
    assert len(vertex_near(mesh, 0.0, 0.0)) == 1


def test_points_keep_the_number_that_they_have_in_the_whole_mesh():
    points = QuadraturePoints(rectangle(WORLD, 3.0, 1.0, 3, 1, element("Q4")), element("Q4"))
    x = points.coordinates()[np.argsort(points.index)]
    assert sorted(points.index) == list(range(12))
    assert (np.floor(x[:, 0]) == np.repeat([0, 1, 2], 4)).all()


@pytest.mark.parametrize(
    "sizes, message",
    [
        ((0.0, 1.0, 2, 2), "both sizes must be positive"),
        ((1.0, -1.0, 2, 2), "both sizes must be positive"),
        ((1.0, float("nan"), 2, 2), "both sizes must be positive"),
        ((1.0, 1.0, 0, 2), "one at least"),
        ((1.0, 1.0, 10**9, 10**9), "1000000000 x 1000000000 cells: more than"),
    ],
)
def test_impossible_sizes_are_refused(sizes, message):
    with pytest.raises(ValueError, match=message):
        rectangle(WORLD, *sizes, element("Q4"))


def test_a_distortion_that_could_fold_cells_is_refused():
    with pytest.raises(ValueError, match="mesh distortion"):
        rectangle(WORLD, 1.0, 1.0, 2, 2, element("Q4"), distortion=0.5)
