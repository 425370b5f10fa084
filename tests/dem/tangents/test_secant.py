"""PSTLO-secant: PSTLO where nothing slides, the step's own answer along the step where it does."""

from dataclasses import replace

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.response import Response
from femxdem_fenicsx.dem.tangents import operator
from femxdem_fenicsx.dem.tangents.secant import SOFTEST, STIFFEST, correction
from tests.reference import reference_packing

from .scenes import at_rest

STEP = np.array([[1.0002, 1e-4], [0.0, 0.9995]])


def along_step(C: np.ndarray) -> np.ndarray:
    return np.einsum("ijkl,kl->ij", C, STEP - np.eye(2))


@pytest.fixture(scope="module")
def sliding() -> Response:
    """A packing on its way to the peak, one step on."""
    response = Response(reference_packing(), 1, PRESETS["balanced"])
    for _ in range(6):
        response.deform(np.diag([1.0003, 0.999])[None])
        response.commit()
    response.deform(STEP[None])
    return response


def test_where_nothing_slides_it_is_pstlo():
    packing = reference_packing()
    response = at_rest(packing.but(law=replace(packing.law, friction=1e6)))
    response.deform(STEP[None])
    elastic, C = (operator(name)(response, STEP[None])[0] for name in ("PSTLO", "PSTLO-secant"))
    # the elastic response is not quite linear over the step: contacts close and stiffen
    np.testing.assert_allclose(C, elastic, rtol=0, atol=5e-2 * np.abs(elastic).max())


def test_along_the_step_it_gives_the_change_of_the_stress(sliding):
    change = (sliding.outcome.stress - sliding.committed_outcome.stress)[0]
    elastic, C = (operator(name)(sliding, STEP[None])[0] for name in ("PSTLO", "PSTLO-secant"))
    assert np.abs(along_step(elastic) - change).max() > 0.1 * np.abs(change).max()
    np.testing.assert_allclose(along_step(C), change, rtol=0, atol=1e-3 * np.abs(change).max())


def test_it_foretells_a_longer_step_where_pstlo_does_not(sliding):
    farther = np.eye(2) + 1.5 * (STEP - np.eye(2))
    before = sliding.outcome.stress[0].copy()
    elastic, C = (operator(name)(sliding, STEP[None])[0] for name in ("PSTLO", "PSTLO-secant"))
    change = sliding.probe(farther[None], np.zeros(1, np.int64)).stress[0] - before
    off = [np.linalg.norm(0.5 * along_step(tangent) - change) for tangent in (elastic, C)]
    assert off[1] < 0.6 * off[0]


def test_of_a_plastic_mechanism_the_flow_is_found():
    """Half of the elastic change lost along the step: half of that stiffness, all of the others."""
    identity = np.einsum("ik,jl->ijkl", np.eye(2), np.eye(2))
    C = (0.5 * (identity + np.swapaxes(identity, 2, 3)))[None]
    E = np.diag([1e-3, -1e-3])[None]
    corrected = (C + correction(C, E, 0.5 * E))[0]
    np.testing.assert_allclose(np.einsum("ijkl,kl->ij", corrected, E[0]), 0.5 * E[0], atol=1e-15)
    others = np.array([[1.0, 0.0], [0.0, 1.0]]), np.array([[0.0, 1.0], [1.0, 0.0]])
    for strain in others:
        np.testing.assert_allclose(np.einsum("ijkl,kl->ij", corrected, strain), strain, atol=1e-15)


@pytest.mark.parametrize("answer, left", [(-2.0, SOFTEST), (0.0, SOFTEST), (9.0, STIFFEST)])
def test_the_stiffness_along_the_step_stays_within_bounds(answer, left):
    C = np.einsum("ik,jl->ijkl", np.eye(2), np.eye(2))[None]
    E = np.diag([5e-4, -1e-3])[None]
    corrected = (C + correction(C, E, answer * E))[0]
    along = np.einsum("ijkl,ij,kl->", corrected, E[0], E[0])
    assert along == pytest.approx(left * (E * E).sum())


def test_a_point_that_hardly_strains_keeps_its_elastic_tangent():
    C = np.einsum("ik,jl->ijkl", np.eye(2), np.eye(2))[None]
    assert not correction(C, np.diag([1e-5, -1e-5])[None], np.ones((1, 2, 2))).any()
    assert not correction(C, np.zeros((1, 2, 2)), np.zeros((1, 2, 2))).any()
