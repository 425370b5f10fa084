"""The continuum that the options of a demo ask for."""

import pytest
from mpi4py import MPI

from demos import biaxial
from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from forms.media import medium_for
from meshes.rectangle import rectangle

SECOND = ("--gradient", "second", "--second-gradient-modulus", "3")


@pytest.mark.parametrize(
    "words, dofs_of_a_cell",
    [
        ((), 2 * 8),
        (SECOND, 2 * 8 + 4 * 4 + 4),
        ((*SECOND, "--micro-strain", "quadratic"), 2 * 8 + 4 * 8 + 4),
    ],
)
def test_options_choose_the_unknowns(words, dofs_of_a_cell):
    kind = element("Q8")
    points = QuadraturePoints(rectangle(MPI.COMM_SELF, 1.0, 1.0, 1, 1, kind), kind)
    medium = medium_for(biaxial.arguments().parse_args(list(words)), points)
    assert len(medium.unknown.x.array) == dofs_of_a_cell
