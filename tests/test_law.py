"""The analytic laws against finite differences and their closed forms."""

import h5py
import numpy as np
import pytest

from femxdem_fenicsx.law import (
    LinearElastic,
    LinearShearSoftening,
    NeoHookean,
    ShearSoftening,
    Softening,
)

SIZE = 6
LAWS = {
    "linear elastic": lambda: LinearElastic(SIZE, 100.0, 0.3, initial_stress=-np.eye(2)),
    "neo-Hookean": lambda: NeoHookean(SIZE, 100.0, 0.3),
    "softening": lambda: Softening(SIZE, 100.0, 0.3, threshold=0.05),
    "softening in shear": lambda: ShearSoftening(SIZE, 100.0, 0.3, 0.05, 4.0),
    "linear softening in shear": lambda: LinearShearSoftening(SIZE, 100.0, 0.3, 0.05, 4.0),
    "linear elastic in 3D": lambda: LinearElastic(SIZE, 100.0, 0.3, -np.eye(3), dim=3),
    "neo-Hookean in 3D": lambda: NeoHookean(SIZE, 100.0, 0.3, dim=3),
    "softening in 3D": lambda: Softening(SIZE, 100.0, 0.3, threshold=0.05, dim=3),
}


@pytest.fixture(params=LAWS)
def make(request):
    return LAWS[request.param]


@pytest.fixture
def law(make):
    return make()


def deformation(seed: int, dim: int = 2, amplitude: float = 0.1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.eye(dim) + amplitude * rng.uniform(-1, 1, (SIZE, dim, dim))


def test_tangent_is_the_derivative_of_the_stress_by_the_increment(law):
    law.evaluate(deformation(1, law.dim))
    law.commit()
    F, h = deformation(2, law.dim), 1e-6
    law.evaluate(F)
    C = law.tangent()
    for k in range(law.dim):
        for m in range(law.dim):
            step = np.zeros((law.dim, law.dim))
            step[k, m] = h
            difference = (law.evaluate(F + step) - law.evaluate(F - step)) / (2 * h)
            np.testing.assert_allclose(C[..., k, m], difference, atol=2e-6)


def test_evaluate_is_a_function_of_F_alone_until_the_commit(law):
    F = deformation(3, law.dim)
    first = law.evaluate(F).copy()
    law.evaluate(deformation(4, law.dim))
    law.discard()
    law.commit()  # nothing to commit any more
    np.testing.assert_array_equal(law.evaluate(F), first)


def test_saved_state_comes_back_bit_for_bit(make, tmp_path):
    law, again = make(), make()
    law.evaluate(deformation(5, law.dim))
    law.commit()
    with h5py.File(tmp_path / "law.h5", "w") as file:
        law.save(file.create_group("law"))
        again.load(file["law"])
    F = deformation(6, law.dim)
    np.testing.assert_array_equal(again.evaluate(F), law.evaluate(F))
    np.testing.assert_array_equal(again.stress, law.stress)


def test_the_committed_stress_is_what_no_further_deformation_gives(law):
    law.evaluate(deformation(5, law.dim))
    law.commit()
    law.evaluate(deformation(6, law.dim))
    rest = np.tile(np.eye(law.dim), (SIZE, 1, 1))
    np.testing.assert_allclose(law.stress, law.evaluate(rest), rtol=1e-13)


def test_neo_hookean_stress_depends_on_the_total_deformation_only_and_turns_with_it():
    law, F = LAWS["neo-Hookean"](), deformation(7)
    at_once = law.evaluate(F)
    half = deformation(8)
    law.evaluate(half)
    law.commit()
    np.testing.assert_allclose(law.evaluate(F @ np.linalg.inv(half)), at_once, atol=1e-12)
    turn = np.array([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]])
    law = LAWS["neo-Hookean"]()
    np.testing.assert_allclose(law.evaluate(turn @ F), turn @ at_once @ turn.T, atol=1e-12)


def test_softening_peaks_at_the_threshold_and_stays_damaged():
    law = LAWS["softening"]()

    def stress(strain: float) -> float:
        return law.evaluate(np.tile(np.diag([1.0, 1.0 - strain]), (SIZE, 1, 1)))[0, 1, 1]

    stiffness = -stress(0.01) / 0.01
    assert -stress(0.05) == pytest.approx(0.05 * stiffness)
    assert -stress(0.10) == pytest.approx(0.05 * stiffness * np.exp(-1))
    law.commit()
    law.evaluate(np.tile(np.diag([1.0, 1.0 / 0.9]), (SIZE, 1, 1)))
    assert -stress(-0.05) == pytest.approx(0.025 * stiffness * np.exp(-1))


@pytest.mark.parametrize("young, poisson", [(0.0, 0.3), (-1.0, 0.3), (1.0, 0.5), (1.0, -1.0)])
def test_elastic_constants_without_a_stable_material_are_refused(young, poisson):
    with pytest.raises(ValueError, match=r"E > 0 and -1 < nu < 0\.5"):
        LinearElastic(1, young, poisson)


def test_softening_threshold_must_be_positive():
    with pytest.raises(ValueError, match="must be positive"):
        Softening(2, 1.0, 0.3, threshold=[0.1, 0.0])
