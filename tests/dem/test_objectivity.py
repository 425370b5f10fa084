"""A rotation turns the stress and does nothing else, whatever the packing went through before."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.response import Response
from tests.reference import reference_packing, reference_spheres

PRESSURE = 1e5
#: What a hold changes in a packing that was sheared before, over the pressure: at most.
CREEP = {"fast": 8e-3, "balanced": 2e-3, "reference": 3e-4}
#: An angle by which nothing turns, but for which there is a hold.
HARDLY = 2.0**-30


@pytest.fixture(scope="module")
def packings():
    return {2: reference_packing(), 3: reference_spheres()}


def rotation(dim: int, angle: float) -> np.ndarray:
    """In the plane of the first and last axes, (d, d)."""
    R = np.eye(dim)
    R[0, 0] = R[-1, -1] = np.cos(angle)
    R[0, -1], R[-1, 0] = -np.sin(angle), np.sin(angle)
    return R


def sheared(packing, accuracy: str) -> Response:
    """After 1 % of simple shear, which strains and turns."""
    response = Response(packing, 1, PRESETS[accuracy])
    F = np.eye(packing.dim)
    F[0, -1] = 1e-3
    for _ in range(10):
        response.deform(F[None])
        response.commit()
    return response


@pytest.mark.parametrize("accuracy", list(PRESETS))
@pytest.mark.parametrize("dim", [2, 3])
def test_after_shear_a_rigid_turn_of_either_sense_turns_the_stress(packings, dim, accuracy):
    response = sheared(packings[dim], accuracy)
    before = response.committed_outcome.stress[0].copy()
    held = response.deform(rotation(dim, HARDLY)[None]).stress[0].copy()
    assert np.abs(held - before).max() < CREEP[accuracy] * PRESSURE
    for angle in (-1e-2, -1e-3, 1e-3, 1e-2):
        R = rotation(dim, angle)
        turned = R.T @ response.deform(R[None]).stress[0] @ R
        assert np.abs(turned - held).max() < 1e-4 * PRESSURE


@pytest.mark.parametrize("accuracy", list(PRESETS))
def test_turning_to_and_fro_beside_a_stretch_changes_nothing(packings, accuracy):
    """Each step stretches the packing; in one of two it turns by 1 mrad besides, to and fro."""
    stretch = np.diag([1 / 0.999, 0.999])
    straight, turning = (Response(packings[2], 1, PRESETS[accuracy]) for _ in range(2))
    last = np.eye(2)
    for step in range(10):
        R = rotation(2, 1e-3 if step % 2 == 0 else 0.0)
        expected = straight.deform(stretch[None]).stress[0]
        turned = R.T @ turning.deform((R @ stretch @ last.T)[None]).stress[0] @ R
        assert np.abs(turned - expected).max() < 5e-3 * PRESSURE
        straight.commit()
        turning.commit()
        last = R
