"""Tangent operators against closed forms and finite differences."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.homogenisation import touching
from femxdem_fenicsx.dem.response import Response
from femxdem_fenicsx.dem.tangents import OPERATORS, operator
from femxdem_fenicsx.dem.tangents.aeo import STEPS
from femxdem_fenicsx.dem.tangents.network import strains
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from tests.reference import reference_packing

from ..scenes import FRICTIONLESS, RADIUS, STIFFNESS, hexagonal, two_grains

RATIO = 0.6
STICKING = LinearContact(stiffness=STIFFNESS, stiffness_ratio=RATIO, friction=50.0)
EXACT = PRESETS["fast"].but(tolerance=1e-9, hold_limit=100)
IDENTITY = np.eye(2)[None]


def at_rest(packing) -> Response:
    return Response(packing, 1, EXACT)


def uko(packing) -> np.ndarray:
    return operator("UKO")(at_rest(packing), IDENTITY)[0]


def kruyt_sum(packing) -> np.ndarray:
    """1/V sum (k_n n n + k_t t t) b b, Argilaga eq. 13, over the contacts found by `touching`."""
    contacts, ratio = touching(packing), packing.law.stiffness_ratio
    n = contacts.normals
    t = np.column_stack([-n[:, 1], n[:, 0]])
    ratio = ratio if packing.law.friction > 0 else 0.0
    directions = np.einsum("ci,ck->cik", n, n) + ratio * np.einsum("ci,ck->cik", t, t)
    b = contacts.branches
    return np.einsum("c,cik,cj,cl->ijkl", contacts.stiffness, directions, b, b) / packing.volume


@pytest.mark.parametrize("law", [FRICTIONLESS, STICKING], ids=["frictionless", "sticking"])
def test_uko_of_two_grains_is_one_term_of_the_sum(law):
    packing = two_grains(-1e-4, law, angle=0.0)
    length = 2 * RADIUS - 1e-4
    expected = np.zeros((2, 2, 2, 2))
    expected[0, 0, 0, 0] = STIFFNESS * length**2 / packing.volume
    expected[1, 0, 1, 0] = (RATIO if law is STICKING else 0.0) * expected[0, 0, 0, 0]
    np.testing.assert_allclose(uko(packing), expected, atol=1e-6 * expected.max())
    turned = two_grains(-1e-4, law, angle=0.8)
    np.testing.assert_allclose(uko(turned), kruyt_sum(turned), rtol=1e-9)


def test_uko_of_a_hexagonal_packing_is_isotropic_in_closed_form():
    C = uko(hexagonal(law=STICKING))
    scale = 2 * np.sqrt(3) * STIFFNESS / 0.1  # three contacts a grain, mean of n n n n
    closed = {
        (0, 0, 0, 0): 3 / 8 + RATIO / 8,
        (1, 1, 1, 1): 3 / 8 + RATIO / 8,
        (0, 0, 1, 1): (1 - RATIO) / 8,
        (0, 1, 0, 1): 1 / 8 + 3 * RATIO / 8,
        (0, 1, 1, 0): (1 - RATIO) / 8,
        (0, 0, 0, 1): 0.0,
    }
    for index, value in closed.items():
        assert C[index] / scale == pytest.approx(value, abs=1e-10), index


def test_uko_of_400_disks_is_the_sum_over_their_contacts_and_has_major_symmetry():
    packing = reference_packing()
    C = uko(packing)
    np.testing.assert_allclose(C, kruyt_sum(packing), atol=1e-12 * C.max())
    np.testing.assert_allclose(C, C.transpose(2, 3, 0, 1), atol=1e-12 * C.max())
    assert np.linalg.eigvalsh(C.reshape(4, 4)).min() > 0


def test_uko_is_taken_at_the_trial_state_not_at_the_committed_one():
    response = at_rest(hexagonal(law=STICKING))
    F = np.diag([0.999, 1.0])[None]
    response.deform(F)
    moved = operator("UKO")(response, F)[0]
    response.commit()
    after, before = kruyt_sum(response.committed.packing(0)), kruyt_sum(hexagonal(law=STICKING))
    np.testing.assert_allclose(moved, after, atol=1e-9 * after.max())
    assert np.abs(before - after).max() > 1e-4 * after.max()


@pytest.mark.parametrize("law", [FRICTIONLESS, STICKING], ids=["frictionless", "sticking"])
def test_tangents_of_a_lattice_are_the_derivative_of_its_stress(law):
    """A lattice deforms affinely: CTO is exact, UKO is for strains, but for the new geometry.

    For rotations it is not (Argilaga eq. 13): its grains do not turn with the packing.
    """
    packing = hexagonal(overlap=2e-3, law=law)
    F = (np.eye(2) + 1e-5 * np.array([[-2.0, 1.0], [0.5, -1.0]]))[None]
    laws = {name: HomogenisedLaw(packing, 1, EXACT, name) for name in ("UKO", "CTO")}
    for each in laws.values():
        each.evaluate(F)
    C = {name: each.tangent()[0] for name, each in laws.items()}
    differences, h = np.zeros((2, 2, 2, 2)), 2.0**-20  # the law rounds strains to 2^-30
    for k in range(2):
        for m in range(2):
            step = np.zeros((1, 2, 2))
            step[0, k, m] = h
            plus, minus = laws["CTO"].evaluate(F + step), laws["CTO"].evaluate(F - step)
            differences[..., k, m] = (plus - minus)[0] / (2 * h)
    scale = np.abs(differences).max()
    np.testing.assert_allclose(C["CTO"], differences, atol=1e-4 * scale)
    for_strains = [0.5 * (c + c.swapaxes(2, 3)) for c in (C["UKO"], differences)]
    np.testing.assert_allclose(*for_strains, atol=1e-2 * scale)


def test_cto_of_400_disks_is_the_change_of_stress_over_a_perturbation_of_the_steps_size():
    law = HomogenisedLaw(reference_packing(), 2, PRESETS["balanced"], "CTO")
    F = np.array([np.diag([1.0004, 0.999]), [[1.0, 3e-4], [0.0, 1.0]]])
    stress = law.evaluate(F)
    C = law.tangent()
    for point in range(2):
        size = np.linalg.norm(F[point] - np.eye(2))
        for strain in strains(2):
            perturbed = F.copy()
            perturbed[point] = (np.eye(2) + size * strain) @ F[point]
            change = law.evaluate(perturbed)[point] - stress[point]
            along = C[point] @ F[point].T  # C_ijkl dF_km F_lm^-1, undone
            predicted = np.einsum("ijkl,kl->ij", along, size * strain)
            np.testing.assert_allclose(predicted, change, rtol=1e-4, atol=1.0)


def test_cto_leaves_the_trial_to_be_committed():
    with_tangent, without = (
        HomogenisedLaw(reference_packing(), 1, PRESETS["fast"], "CTO") for _ in range(2)
    )
    F = np.diag([1.0005, 0.999])[None]
    for law in (with_tangent, without):
        law.evaluate(F)
    with_tangent.tangent()
    for law in (with_tangent, without):
        law.commit()
    np.testing.assert_array_equal(with_tangent.stress, without.stress)
    np.testing.assert_array_equal(with_tangent.evaluate(F), without.evaluate(F))


def test_an_affine_estimate_is_stiffer_than_the_packing():
    F = np.diag([1.0005, 0.999])[None]
    stiffness = {}
    for name in ("UKO", "CTO", "PSTLO"):
        law = HomogenisedLaw(reference_packing(), 1, PRESETS["balanced"], name)
        law.evaluate(F)
        stiffness[name] = law.tangent()[0]
    for k in range(2):
        assert stiffness["CTO"][k, k, k, k] < stiffness["PSTLO"][k, k, k, k]
        assert stiffness["PSTLO"][k, k, k, k] < stiffness["UKO"][k, k, k, k]


def test_aeo_is_the_mean_of_the_first_steps_ctos_and_stays_it():
    aeo, cto = (HomogenisedLaw(reference_packing(), 1, PRESETS["fast"], n) for n in ("AEO", "CTO"))
    F, tangents = np.diag([1.0004, 0.999])[None], []
    for step in range(STEPS + 2):
        for law in (aeo, cto):
            law.evaluate(F)
        C = aeo.tangent()
        if step < STEPS:
            aeo.tangent()  # the last one of a step counts, and each step once
            tangents.append(cto.tangent())
            np.testing.assert_array_equal(C, tangents[-1])
        else:
            np.testing.assert_allclose(C, np.mean(tangents, axis=0), rtol=1e-12)
        for law in (aeo, cto):
            law.commit()


def test_corrected_kruyt_operators_have_the_terms_of_the_cto_that_they_were_calibrated_with():
    F, C = np.diag([1.0004, 0.999])[None], {}
    for name in ("UKO", "CTO", "UCKO", "UCKO-2DOF"):
        response = Response(reference_packing(), 1, PRESETS["balanced"])
        response.deform(F)
        calibrated = operator(name)
        C[name] = calibrated(response, F)[0]
        response.commit()
        response.deform(F)
        if name.startswith("UCKO"):
            factors = calibrated.memory["factors"].copy()
            calibrated(response, F)
            np.testing.assert_array_equal(calibrated.memory["factors"], factors)
    normal = {name: c[0, 0, 0, 0] + c[1, 1, 1, 1] for name, c in C.items()}
    coupling = {name: c[0, 0, 1, 1] + c[1, 1, 0, 0] for name, c in C.items()}
    assert normal["UCKO"] == pytest.approx(normal["CTO"])
    np.testing.assert_allclose(C["UCKO"], C["UKO"] * normal["CTO"] / normal["UKO"])
    assert normal["UCKO-2DOF"] == pytest.approx(normal["CTO"])
    assert coupling["UCKO-2DOF"] == pytest.approx(coupling["CTO"])


@pytest.mark.parametrize("name", ["UKO", "CTO"])
def test_threads_change_no_bit_of_a_tangent(name):
    F = np.eye(2) + 1e-3 * np.random.default_rng(0).uniform(-1, 1, (5, 2, 2))
    tangents = []
    for threads in (1, 2):
        law = HomogenisedLaw(reference_packing(), 5, PRESETS["fast"], name, threads)
        law.evaluate(F)
        tangents.append(law.tangent())
    np.testing.assert_array_equal(*tangents)


def test_an_unknown_operator_is_answered_with_the_known_ones():
    with pytest.raises(ValueError, match=r"'XYZ'.*CTO, AEO, UKO"):
        operator("XYZ")
    papers = {"CTO", "AEO", "UKO", "UCKO", "UCKO-2DOF", "KAO", "DEMQO", "PSTLO"}
    assert set(OPERATORS) == papers | {"PSTLO-secant"}
