"""What goes to the law and what comes back."""

import re

import numpy as np
import pytest

from femxdem_fenicsx.law import InadmissibleDeformation, LinearElastic
from tests.fem.laws import Counting
from tests.fem.specimen import Specimen


def test_the_law_sees_its_points_in_order():
    specimen = Specimen(lambda points: Counting(points.size), name="Q9")
    specimen.u.interpolate(lambda x: np.array([0.01 * x[0] * x[1], 0.02 * x[1] ** 2]))
    specimen.operator.evaluate()
    x, y = specimen.points.coordinates().T
    exact = np.array([[1 + 0.01 * y, 0.01 * x], [0 * x, 1 + 0.04 * y]]).transpose(2, 0, 1)
    np.testing.assert_allclose(specimen.law.F, exact, atol=1e-13)


def test_a_law_of_another_size_is_refused():
    message = re.escape("make the law with points.size")
    with pytest.raises(ValueError, match=message):
        Specimen(lambda points: LinearElastic(points.size + 1, 1.0, 0.3))


@pytest.mark.parametrize("gradient", [-1.5, 0.7, np.nan])
def test_deformations_beyond_reason_never_reach_the_law(gradient):
    specimen = Specimen(lambda points: Counting(points.size))
    specimen.u.interpolate(lambda x: np.array([gradient * x[0], 0 * x[0]]))
    with pytest.raises(InadmissibleDeformation, match="went astray or the step is too large"):
        specimen.operator.evaluate()
    assert specimen.law.evaluations == 0


def test_cell_means_are_weighted_by_volume():
    specimen = Specimen(lambda points: Counting(points.size), name="Q8", distortion=0.3)
    points = specimen.points
    x = points.coordinates()
    means = points.cell_means(np.column_stack([np.ones(points.size), x]))
    np.testing.assert_allclose(means[:, 0], 1.0, rtol=1e-14)
    volumes = points.volumes().reshape(len(points.cells), -1)
    assert np.ptp(volumes) > 1e-3
    total = (means * volumes.sum(axis=1)[:, None]).sum(axis=0)
    np.testing.assert_allclose(total, [2.0, 1.0, 2.0], rtol=1e-12)
