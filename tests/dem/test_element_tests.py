"""One material point under mixed control: closed forms, and YADE's drained test."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.element_tests import drained_biaxial, drained_compression, increment
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from femxdem_fenicsx.law import LinearElastic, NeoHookean
from tests.reference import reference_packing, table

YOUNG, POISSON, CONFINING = 1e7, 0.3, 1e5
LAME = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
SHEAR = YOUNG / (2 * (1 + POISSON))


def elastic(shear_stress: float = 0.0) -> LinearElastic:
    initial = -CONFINING * np.eye(2)
    initial[0, 1] = initial[1, 0] = shear_stress
    return LinearElastic(1, YOUNG, POISSON, initial)


def test_drained_compression_of_an_elastic_solid_is_the_closed_form():
    steps, strain = 20, 0.04
    states = list(drained_biaxial(elastic(), CONFINING, strain, strain / steps))
    heights = 1 - np.arange(steps + 1) * strain / steps
    axial = np.diff(heights) / heights[:-1]  # of each increment
    lateral = -LAME / (LAME + 2 * SHEAR) * axial
    stiffness = LAME + 2 * SHEAR - LAME**2 / (LAME + 2 * SHEAR)
    assert len(states) == steps
    for k, state in enumerate(states, 1):
        assert state.axial_strain == pytest.approx(k * strain / steps)
        assert state.stress[0, 0] == pytest.approx(-CONFINING, rel=1e-3)
        assert state.stress[1, 1] == pytest.approx(-CONFINING + stiffness * axial[:k].sum(), 1e-3)
        width = np.prod(1 + lateral[:k])
        assert state.volumetric_strain == pytest.approx(width * heights[k] - 1, abs=1e-5)
        assert state.stress_ratio == state.stress[1, 1] / state.stress[0, 0]
        assert state.error <= 1e-3 * CONFINING
        assert state.evaluations <= 2  # linear: the tangent leads there at once


def test_a_free_shear_lets_the_shear_stress_go_and_a_rectangular_box_keeps_it():
    free = list(drained_biaxial(elastic(2e4), CONFINING, 2e-3, 1e-3, free_shear=True))
    kept = list(drained_biaxial(elastic(2e4), CONFINING, 2e-3, 1e-3))
    assert abs(free[-1].stress[0, 1]) <= 1e-3 * CONFINING
    assert free[0].deformation[0, 1] == pytest.approx(-2e4 / SHEAR, rel=1e-2)
    assert free[-1].deformation[1, 0] == 0.0
    assert kept[-1].stress[0, 1] == pytest.approx(2e4)
    assert kept[-1].deformation[0, 1] == 0.0


def test_triaxial_compression_of_an_elastic_solid_has_youngs_modulus_and_poissons_ratio():
    initial = -CONFINING * np.eye(3)
    initial[0, 1] = initial[1, 0] = initial[1, 2] = initial[2, 1] = 1e3
    law = LinearElastic(1, YOUNG, POISSON, initial, dim=3)
    (state,) = drained_compression(law, CONFINING, 1e-3, 1e-3, free_shear=True, tolerance=1e-9)
    strain = 0.5 * (state.deformation + state.deformation.T) - np.eye(3)
    shear = -1e3 / (2 * SHEAR)
    lateral = POISSON * 1e-3
    expected = [[lateral, shear, 0.0], [shear, lateral, shear], [0.0, shear, -1e-3]]
    np.testing.assert_allclose(strain, expected, atol=1e-12)
    assert (np.tril(state.deformation, -1) == 0).all()
    assert state.stress_ratio == pytest.approx(1 + YOUNG * 1e-3 / CONFINING)
    assert state.axial_strain == pytest.approx(1e-3)


def test_a_nonlinear_solid_reaches_the_stress_within_the_tolerance():
    law = NeoHookean(1, YOUNG, POISSON)
    controlled = np.array([[True, True], [False, True]])
    target = np.array([[-3e5, 2e5], [0.0, -8e5]])
    F, state = increment(law, np.eye(2), controlled, target, tolerance=1.0)
    np.testing.assert_allclose(state.stress[controlled], target[controlled], atol=1.0)
    assert state.evaluations > 2
    np.testing.assert_allclose(law.evaluate(np.eye(2)[None])[0], state.stress)  # committed
    assert F[1, 0] == 0.0


class Bounded:
    """A law whose stress ends at a limit, Pa; it counts what is done to it."""

    dim, size = 2, 1

    def __init__(self, limit: float):
        self.limit, self.evaluations, self.committed, self.discarded = limit, 0, 0, 0

    def evaluate(self, F):
        self.evaluations += 1
        return self.limit * np.tanh(1e7 * (F - np.eye(2)) / max(self.limit, 1.0))

    def tangent(self):
        return 1e7 * np.einsum("ik,jl->ijkl", np.eye(2), np.eye(2))[None]

    def commit(self):
        self.committed += 1

    def discard(self):
        self.discarded += 1


@pytest.mark.parametrize("limit", [0.0, 5e4], ids=["deaf", "too weak"])
def test_a_stress_that_is_not_reached_is_an_error_and_nothing_is_committed(limit):
    law, lateral = Bounded(limit), np.array([[True, False], [False, False]])
    with pytest.raises(RuntimeError, match=r"stress off by .* Pa after \d evaluations"):
        increment(law, np.eye(2), lateral, -1e5 * np.eye(2), 1.0, most=7)
    assert 1 < law.evaluations <= 7
    assert (law.committed, law.discarded) == (0, 1)


# Against YADE


@pytest.fixture(scope="module")
def drained():
    """(axial strain, stress ratio, volumetric strain) of the reference packing, box rectangular."""
    law = HomogenisedLaw(reference_packing(), 1, PRESETS["balanced"])
    states = list(drained_biaxial(law, 1e5, 0.03, 1e-3, tolerance=3e-3))
    return np.array([(s.axial_strain, s.stress_ratio, s.volumetric_strain) for s in states]).T


def test_the_drained_stress_ratio_follows_yade_up_to_two_percent(drained):
    strain, ratio, _ = drained
    rows = table("drained_1e-7.csv")
    theirs = np.interp(strain, -rows["axial_eng_strain"], rows["stress_ratio_syy_over_sxx"])
    before = strain < 0.0201
    assert before.sum() == 20
    assert np.abs(ratio - theirs)[before].max() < 0.03


def test_the_drained_volume_follows_yade_up_to_two_percent(drained):
    strain, _, volume = drained
    rows = table("drained_1e-7.csv")
    theirs = np.interp(strain, -rows["axial_eng_strain"], np.expm1(rows["vol_log_strain"]))
    before = strain < 0.0201
    assert np.abs(volume - theirs)[before].max() < 3e-4
    assert volume[before].min() < -1e-3  # contraction first, dilation later
    assert volume[-1] > volume[before].min() + 1e-3


def test_the_drained_peak_is_yades(drained):
    strain, ratio, _ = drained
    assert ratio.max() == pytest.approx(2.88, rel=0.02)
    assert 0.017 < strain[ratio.argmax()] < 0.024
