"""Names and points of elements."""

import pytest

from femxdem_fenicsx.fem import _dolfinx
from femxdem_fenicsx.fem.elements import element


@pytest.mark.parametrize(
    "name, points, count",
    [
        ("Q4", None, 4),
        ("Q8", None, 4),
        ("Q8", "3x3", 9),
        ("Q9", None, 9),
        ("T6", None, 3),
        ("H8", None, 8),
        ("H27", None, 27),
        ("T4", None, 1),
        ("T10", None, 4),
    ],
)
def test_elements_have_the_points_of_their_name(name, points, count):
    kind = element(name, points)
    assert kind.points_per_cell == count
    assert len(_dolfinx.quadrature_rule(kind.cell, kind.quadrature_degree)[0]) == count


def test_unknown_element_lists_the_known_ones():
    with pytest.raises(
        ValueError, match="'Q7' is unknown: choose one of Q4, Q8, Q9, T6, H8, H27, T4, T10"
    ):
        element("Q7")


def test_q9_with_2x2_points_is_refused_because_it_is_singular():
    with pytest.raises(ValueError, match="singular: hourglass modes"):
        element("Q9", "2x2")


def test_an_element_of_another_dimension_is_refused_with_those_to_choose_from():
    element("H8").check_dim(3)
    with pytest.raises(ValueError, match="H8 is for 3D: choose one of Q4, Q8, Q9, T6"):
        element("H8").check_dim(2)
    with pytest.raises(ValueError, match="Q4 is for 2D: choose one of H8, H27, T4, T10"):
        element("Q4").check_dim(3)
