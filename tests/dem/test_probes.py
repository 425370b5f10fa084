"""Response envelopes of an elastic solid, and of grains at rest."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.probes import strain_probes, stress_probes
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from femxdem_fenicsx.law import LinearElastic
from tests.reference import reference_packing

YOUNG, POISSON = 1e7, 0.3
LAME = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
SHEAR = YOUNG / (2 * (1 + POISSON))


def stiffness(dim: int) -> np.ndarray:
    """Of the lateral (times sqrt(d - 1)) and axial components."""
    n = dim - 1
    return 2 * SHEAR * np.eye(2) + LAME * np.array([[n, np.sqrt(n)], [np.sqrt(n), 1.0]])


@pytest.mark.parametrize("dim", [2, 3])
def test_strain_probes_of_an_elastic_solid_are_its_ellipse(dim):
    law = LinearElastic(24, YOUNG, POISSON, -1e5 * np.eye(dim), dim=dim)
    found = strain_probes(law, 1e-4)
    np.testing.assert_allclose(np.linalg.norm(found.strain, axis=1), 1e-4)
    np.testing.assert_allclose(found.stress, found.strain @ stiffness(dim), rtol=1e-6, atol=1e-6)
    bounds = np.linalg.eigvalsh(stiffness(dim))
    assert found.stiffness.min() == pytest.approx(bounds[0], rel=6e-2)
    assert found.stiffness.max() == pytest.approx(bounds[1], rel=2e-2)


@pytest.mark.parametrize("dim", [2, 3])
def test_stress_probes_are_the_inverse(dim):
    found = stress_probes(
        lambda: LinearElastic(1, YOUNG, POISSON, -1e5 * np.eye(dim), dim=dim), 1e3, 12, 1e-3
    )
    np.testing.assert_allclose(np.linalg.norm(found.stress, axis=1), 1e3, rtol=1e-4)
    np.testing.assert_allclose(found.strain @ stiffness(dim), found.stress, rtol=1e-3, atol=1e-2)


def test_grains_at_rest_answer_softer_than_their_upper_bound_and_stay_as_they_are():
    law = HomogenisedLaw(reference_packing(), 8, PRESETS["balanced"])
    C = law.tangent()[0]
    bound = np.linalg.norm([[C[i, i, j, j] for j in range(2)] for i in range(2)], 2)
    before = law.evaluate(np.broadcast_to(np.eye(2), (8, 2, 2)))
    law.discard()
    found = strain_probes(law, 2e-4)
    assert 0.3 * bound < found.stiffness.max() < bound
    assert found.stiffness.min() > 0.3 * found.stiffness.max()
    opposite = found.stress[:4] + found.stress[4:]  # nearly elastic
    assert np.abs(opposite).max() < 0.1 * np.abs(found.stress).max()
    np.testing.assert_array_equal(law.evaluate(np.broadcast_to(np.eye(2), (8, 2, 2))), before)


def test_probes_that_are_none_are_refused():
    law = LinearElastic(2, YOUNG, POISSON)
    with pytest.raises(ValueError, match="3 directions or more"):
        strain_probes(law, 1e-4)
    with pytest.raises(ValueError, match="size must be positive"):
        strain_probes(law, 0.0)
    with pytest.raises(ValueError, match="size must be positive"):
        stress_probes(lambda: law, -1.0, 8, 1.0)
