"""A law in 3D seen from a 2D mesh."""

import h5py
import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.files import load_packing
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from femxdem_fenicsx.law import LinearElastic, NeoHookean, Softening
from femxdem_fenicsx.plane_strain import PlaneStrain
from tests.reference import DATA

SIZE = 3
LAWS = {
    "linear elastic": lambda dim: LinearElastic(SIZE, 100.0, 0.3, dim=dim),
    "neo-Hookean": lambda dim: NeoHookean(SIZE, 100.0, 0.3, dim=dim),
    "softening": lambda dim: Softening(SIZE, 100.0, 0.3, 0.05, dim=dim),
}


def deformation(seed: int, amplitude: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.eye(2) + amplitude * rng.uniform(-1, 1, (SIZE, 2, 2))


@pytest.mark.parametrize("make", LAWS.values(), ids=LAWS)
def test_an_analytic_law_in_3d_becomes_its_law_of_plane_strain(make):
    wrapped, flat = PlaneStrain(make(3)), make(2)
    for seed in (1, 2):
        F = deformation(seed, 0.1)
        np.testing.assert_allclose(wrapped.evaluate(F), flat.evaluate(F), atol=1e-12)
        np.testing.assert_allclose(wrapped.tangent(), flat.tangent(), atol=1e-11)
        wrapped.commit()
        flat.commit()
    np.testing.assert_allclose(wrapped.stress, flat.stress, atol=1e-12)


def test_the_out_of_plane_stress_of_an_elastic_solid_is_nu_times_the_sum_in_the_plane():
    law = PlaneStrain(LAWS["linear elastic"](3))
    stress = law.evaluate(deformation(3, 1e-3))
    assert (law.out_of_plane_stress == 0).all()  # nothing is committed yet
    law.commit()
    in_plane = np.trace(stress, axis1=1, axis2=2)
    np.testing.assert_allclose(law.out_of_plane_stress, 0.3 * in_plane, rtol=1e-12)


@pytest.fixture
def spheres():
    packing = load_packing(DATA / "spheres.h5", 3)
    return lambda: HomogenisedLaw(packing, SIZE, PRESETS["fast"])


def test_spheres_answer_with_the_plane_block_of_what_they_answer_in_3d(spheres):
    law, wrapped = spheres(), PlaneStrain(spheres())
    first = wrapped.out_of_plane_stress.copy()
    F = deformation(4, 1e-3)
    embedded = np.tile(np.eye(3), (SIZE, 1, 1))
    embedded[:, :2, :2] = F
    stress = law.evaluate(embedded)
    np.testing.assert_array_equal(wrapped.evaluate(F), stress[:, :2, :2])
    np.testing.assert_array_equal(wrapped.tangent(), law.tangent()[:, :2, :2, :2, :2])
    np.testing.assert_array_equal(wrapped.out_of_plane_stress, first)
    wrapped.discard()
    np.testing.assert_array_equal(wrapped.stress[:, 0, 0], wrapped.law.stress[:, 0, 0])
    wrapped.evaluate(F)
    wrapped.commit()
    np.testing.assert_array_equal(wrapped.out_of_plane_stress, stress[:, 2, 2])
    np.testing.assert_allclose(wrapped.deformation, F, atol=1e-8)
    assert wrapped.void_ratio.shape == (SIZE,) and wrapped.packing(0).dim == 3
    assert wrapped.tally.evaluations == 2


def test_a_saved_state_comes_back_bit_for_bit(spheres, tmp_path):
    law, again = PlaneStrain(spheres()), PlaneStrain(spheres())
    law.evaluate(deformation(5, 1e-3))
    law.commit()
    with h5py.File(tmp_path / "law.h5", "w") as file:
        law.save(file.create_group("law"))
        again.load(file["law"])
    np.testing.assert_array_equal(again.out_of_plane_stress, law.out_of_plane_stress)
    F = deformation(6, 1e-3)
    np.testing.assert_array_equal(again.evaluate(F), law.evaluate(F))


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="it must be one in 3D"):
        PlaneStrain(LAWS["neo-Hookean"](2))
    with pytest.raises(ValueError, match=r"F has shape \(3, 3, 3\), expected \(3, 2, 2\)"):
        PlaneStrain(LAWS["neo-Hookean"](3)).evaluate(np.zeros((3, 3, 3)))
    with pytest.raises(AttributeError, match="colour"):
        PlaneStrain(LAWS["neo-Hookean"](3)).colour  # noqa: B018
