"""PSTLO and DEMQO: the derivative of a packing in which nothing slides."""

from dataclasses import replace

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.contacts import HertzMindlin, RollingResistance
from femxdem_fenicsx.dem.response import Response
from femxdem_fenicsx.dem.tangents import operator
from femxdem_fenicsx.dem.tangents.cto import consistent_tangent
from tests.reference import reference_packing, reference_spheres

from ..scenes import FRICTIONLESS, hexagonal, two_grains
from .scenes import EXACT, at_rest, derivative, tangent

IDENTITY = np.eye(2)[None]
SHEARED = [[1.002, 5e-4], [0.0, 0.998]]


@pytest.fixture(scope="module")
def sticking():
    packing = reference_packing()
    return packing.but(law=replace(packing.law, friction=1e6))


@pytest.mark.parametrize("F", [None, SHEARED], ids=["prestressed", "sheared"])
def test_pstlo_is_the_derivative_entry_by_entry_and_demqo_and_cto_agree(sticking, F):
    response = at_rest(sticking, F)
    differences = derivative(response, 1e-7)
    scale = np.abs(differences).max()
    np.testing.assert_allclose(tangent("PSTLO", response), differences, rtol=0, atol=1e-6 * scale)
    np.testing.assert_allclose(tangent("DEMQO", response), differences, rtol=0, atol=1e-2 * scale)
    infinitesimal = consistent_tangent(response, IDENTITY, least=1e-6)[0]
    np.testing.assert_allclose(infinitesimal, differences, rtol=0, atol=1e-2 * scale)


def test_pstlo_without_friction_knows_no_rotation(sticking):
    response = at_rest(hexagonal(overlap=2e-3, law=FRICTIONLESS), [[0.9995, 2e-4], [0.0, 0.9998]])
    differences = derivative(response, 1e-8)
    scale = np.abs(differences).max()
    np.testing.assert_allclose(tangent("PSTLO", response), differences, rtol=0, atol=1e-4 * scale)


def test_in_3d_both_agree():
    packing = reference_spheres()
    packing = packing.but(law=replace(packing.law, friction=1e6))
    # a state in which no grains are about to touch, as some are with longer time steps
    accuracy = EXACT.but(tolerance=1e-8, time_step=0.7)
    response = at_rest(packing, np.diag([1.0003, 1.0003, 0.999]), accuracy)
    pstlo, demqo = tangent("PSTLO", response), tangent("DEMQO", response)
    scale = np.abs(pstlo).max()
    np.testing.assert_allclose(demqo, pstlo, rtol=0, atol=1e-2 * scale)
    assert scale > 100 * np.abs(response.outcome.stress).max()


def test_of_a_sheared_packing_with_friction_both_take_the_elastic_part():
    response = at_rest(reference_packing(), SHEARED)
    pstlo, demqo = tangent("PSTLO", response), tangent("DEMQO", response)
    np.testing.assert_allclose(demqo, pstlo, rtol=0, atol=1e-2 * np.abs(pstlo).max())


def test_a_spin_turns_the_stress(sticking):
    response = at_rest(sticking, SHEARED)
    stress = response.outcome.stress[0]
    W = np.array([[0.0, -1.0], [1.0, 0.0]])
    for name in ("PSTLO", "DEMQO", "CTO", "KAO"):
        spun = np.einsum("ijkl,kl->ij", tangent(name, response), W)
        expected = W @ stress - stress @ W
        np.testing.assert_allclose(spun, expected, rtol=0, atol=1e-4 * np.abs(stress).max())


def test_pstlo_finishes_an_elastic_step_where_uko_only_starts(sticking):
    """Newton on the stress of a packing: what is left of it after two corrections of its strain."""
    response = at_rest(sticking)
    stretch = np.diag([1.0, 1.001])
    target = stretch @ response.outcome.stress[0] @ stretch
    left = {}
    for name in ("PSTLO", "UKO"):
        F, residuals = np.eye(2), []
        for _ in range(3):
            out_of_balance = target - response.deform(F[None]).stress[0]
            residuals.append(np.linalg.norm(out_of_balance))
            C = operator(name)(response, F[None])[0]
            symmetric = 0.5 * (C + C.swapaxes(2, 3)).reshape(4, 4)
            E = np.linalg.lstsq(symmetric, out_of_balance.ravel(), rcond=1e-6)[0].reshape(2, 2)
            F = (np.eye(2) + E) @ F
        response.discard()
        left[name] = residuals[2] / residuals[0]
    assert left["PSTLO"] < 1e-3 and left["UKO"] > 1e-2


def test_grains_that_nothing_holds_move_along_and_bear_nothing():
    response = Response(two_grains(-1e-4), 1, PRESETS["fast"])
    assert np.abs(tangent("PSTLO", response)).max() < 1e-2 * np.abs(tangent("UKO", response)).max()


def test_pstlo_takes_the_stiffnesses_of_the_contact_law_and_its_rolling_resistance():
    """Nearly: Hertz-Mindlin's tangential forces depend on the way (kept_share)."""
    law = HertzMindlin(
        shear_modulus=3e9, poisson_ratio=0.3, friction=1e6, rolling=RollingResistance(1e6)
    )
    response = at_rest(reference_packing().but(law=law))
    differences = derivative(response, 1e-8)
    scale = np.abs(differences).max()
    np.testing.assert_allclose(tangent("PSTLO", response), differences, rtol=0, atol=4e-3 * scale)


def test_threads_change_no_bit_of_pstlo():
    F = np.eye(2) + 1e-3 * np.random.default_rng(0).uniform(-1, 1, (5, 2, 2))
    tangents = []
    for threads in (1, 2):
        response = Response(reference_packing(), 5, PRESETS["fast"], threads)
        response.deform(F)
        tangents.append(operator("PSTLO")(response, F))
    np.testing.assert_array_equal(*tangents)
