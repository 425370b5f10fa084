"""Packings of spheres: averages, stiffness, work and energy, preparation, YADE's spheres."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.homogenisation import (
    coordination_number,
    elastic_energy,
    fabric,
    fabric_anisotropy,
    measure,
    stress,
    touching,
)
from femxdem_fenicsx.dem.lattices import hexagonal_packing
from femxdem_fenicsx.dem.loading import logarithm
from femxdem_fenicsx.dem.preparation import random_packing
from femxdem_fenicsx.dem.response import Response
from femxdem_fenicsx.dem.tangents import operator
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from tests.reference import reference_packing, reference_spheres, spheres_from_tables, table

from .scenes import RADIUS, STIFFNESS, Moving, cubic, loose_spheres

PRESSURE = 1e5
STICKING = LinearContact(stiffness=STIFFNESS, stiffness_ratio=0.6, friction=50.0)
SLOW = PRESETS["balanced"].but(inertial_number=1e-4, tolerance=1e-4, hold_limit=20000)


@pytest.fixture(scope="module")
def yade():
    return spheres_from_tables()


@pytest.fixture(scope="module")
def dense():
    return random_packing(300, dim=3, pressure=PRESSURE)


# YADE's spheres


def test_stress_contacts_and_void_ratio_of_yades_spheres_are_what_yade_computed(yade):
    sigma = stress(yade)
    np.testing.assert_allclose(np.diag(sigma), [-99997.1, -99996.7, -99999.9], rtol=0, atol=0.1)
    assert sigma[0, 1] == pytest.approx(-443.0, abs=0.1)
    assert len(touching(yade).pairs) == 2891
    assert yade.void_ratio == pytest.approx(0.53712, abs=5e-6)


def test_every_contact_of_yades_spheres_is_found_with_its_force(yade):
    contacts, rows = touching(yade), table("spheres/contacts.csv")
    ours = {tuple(pair): k for k, pair in enumerate(contacts.pairs)}
    pairs = np.sort(np.column_stack([rows["id1"], rows["id2"]]).astype(int), axis=1)
    order = [ours[tuple(pair)] for pair in pairs]
    assert len(set(order)) == len(ours) == len(rows)
    np.testing.assert_allclose(contacts.stiffness[order], rows["kn_N_per_m"], rtol=1e-12)
    np.testing.assert_allclose(contacts.normal_force[order], rows["fn_N"], rtol=1e-6, atol=1e-6)


def test_the_file_of_spheres_is_yades_packing(yade):
    stored = reference_spheres()
    for name in ("box", "positions", "radii", "contacts", "tangential"):
        np.testing.assert_array_equal(getattr(stored, name), getattr(yade, name))
    assert (stored.law, stored.density) == (yade.law, yade.density)


def test_constant_volume_triaxial_compression_follows_yade_up_to_two_percent(yade):
    rows = table("spheres/isochoric.csv")
    law = HomogenisedLaw(yade, 1, PRESETS["balanced"])
    ours = []
    for step in np.diff(rows["log_strain_or_gamma"])[:40]:
        F = np.diag(np.exp([0.5 * step, -step, 0.5 * step]))
        ours.append(np.diag(law.evaluate(F[None])[0]))
        law.commit()
    theirs = np.column_stack([rows[name][1:41] for name in ("sxx_Pa", "syy_Pa", "szz_Pa")])
    assert law.tally.unfinished == 0
    assert np.abs(np.array(ours) - theirs).max() < 0.03 * np.abs(theirs).max()


# Averages


def test_a_cubic_packing_carries_the_closed_form_pressure_with_an_isotropic_fabric():
    overlap = 1e-3
    packing = cubic(overlap=overlap)
    spacing = 2 * RADIUS * (1 - overlap)
    pressure = STIFFNESS * 2 * RADIUS * overlap / spacing**2
    np.testing.assert_allclose(stress(packing), -pressure * np.eye(3), atol=1e-9 * pressure)
    contacts = touching(packing)
    np.testing.assert_allclose(fabric(contacts), np.eye(3) / 3, atol=1e-12)
    assert fabric_anisotropy(fabric(contacts)) == pytest.approx(0, abs=1e-12)
    assert coordination_number(packing) == 6
    assert packing.void_ratio == pytest.approx(6 * (1 - overlap) ** 3 / np.pi - 1)
    assert elastic_energy(packing) == pytest.approx(
        3 * packing.size * 0.5 * STIFFNESS * (2 * RADIUS * overlap) ** 2
    )


def test_contacts_along_one_axis_have_a_fabric_anisotropy_of_15_halves():
    packing = cubic()
    line = packing.but(box=packing.box * [1.0, 1.1, 1.1])  # touching along x alone
    phi = fabric(touching(line))
    np.testing.assert_allclose(phi, np.diag([1.0, 0.0, 0.0]), atol=1e-15)
    assert fabric_anisotropy(phi) == pytest.approx(7.5)


def test_fabric_anisotropy_is_the_amplitude_of_the_density_of_normals():
    """E(n) = (1 + n A n) / 4 pi with a deviator A has F_a = sqrt(3/2 A : A)."""
    rng = np.random.default_rng(2)
    A = rng.normal(size=(3, 3))
    A = 0.1 * (A + A.T - 2 * np.trace(A) / 3 * np.eye(3))
    cosine, weight = np.polynomial.legendre.leggauss(8)
    angle = np.arange(16) * np.pi / 8
    sine = np.sqrt(1 - cosine**2)[:, None]
    n = np.stack([sine * np.cos(angle), sine * np.sin(angle), 0 * sine * angle], -1)
    n[:, :, 2] = cosine[:, None]
    density = (1 + np.einsum("abi,ij,abj->ab", n, A, n)) * weight[:, None] / 32
    assert density.sum() == pytest.approx(1)
    phi = np.einsum("ab,abi,abj->ij", density, n, n)
    assert fabric_anisotropy(phi) == pytest.approx(np.sqrt(1.5 * (A * A).sum()))


def test_stress_times_volume_is_the_derivative_of_the_elastic_energy():
    packing = loose_spheres(120, 8, 0.07 * np.array([[1, 0.3, -0.2], [0, 1, 0.4], [0, 0, 1.0]]))
    sigma, h = stress(packing), 1e-6
    for k, m in np.ndindex(3, 3):
        F = np.zeros((3, 3))
        F[k, m] = h
        plus, minus = (packing.deformed(np.eye(3) + s * F) for s in (1, -1))
        slope = (elastic_energy(plus) - elastic_energy(minus)) / (2 * h * packing.volume)
        assert slope == pytest.approx(sigma[k, m], abs=1e-5 * np.abs(sigma).max())


@pytest.mark.parametrize("cohesion", [0.0, 0.1])
def test_the_kernel_measures_what_the_arrays_say(cohesion):
    law = LinearContact(stiffness=1e4, friction=0.4, cohesion=cohesion)
    packing = loose_spheres(150, 5, 0.07 * np.array([[1, 0.3, 0], [0, 1, 0.2], [0.1, 0, 1]]), law)
    L = [[0.5, 1.0, 0.2], [0.0, -0.5, 0.3], [-0.4, 0.0, 0.1]]
    moving = Moving(packing).advance(100, 2e-5, L, 0.5)
    sigma, phi = np.ones((2, 3, 3))
    count, overlap = measure(
        moving.work.motion, moving.work.pairs, law.elasticity, moving.material.cohesion, None,
        1.0, sigma, phi,
    )  # fmt: skip
    now = moving.now
    contacts = touching(now)
    assert np.abs(contacts.tangential).max() > 0
    assert count == len(contacts.pairs)
    np.testing.assert_allclose(sigma, stress(now), rtol=0, atol=1e-9 * np.abs(sigma).max())
    np.testing.assert_allclose(phi, fabric(contacts), rtol=0, atol=1e-12)
    i, j = contacts.pairs.T
    assert overlap == pytest.approx((contacts.overlaps / (now.radii[i] + now.radii[j])).max())


# Stiffness


def test_uko_of_a_cubic_packing_is_the_closed_form():
    """Per grain one contact along every axis: C_iiii = k_n / s, C_ijij = k_t / s."""
    packing = cubic(law=STICKING)
    response = Response(packing, 1, PRESETS["fast"])
    C = operator("UKO")(response, np.eye(3)[None])[0]
    spacing = 2 * RADIUS * (1 - 1e-3)
    expected = np.zeros((3, 3, 3, 3))
    for i, j in np.ndindex(3, 3):
        expected[i, j, i, j] = STIFFNESS / spacing * (1.0 if i == j else 0.6)
    np.testing.assert_allclose(C, expected, rtol=1e-9, atol=1e-9 * STIFFNESS / spacing)


def test_uko_of_a_random_packing_is_the_sum_over_its_contacts_and_symmetric(dense):
    C = operator("UKO")(Response(dense, 1, PRESETS["fast"]), np.eye(3)[None])[0]
    np.testing.assert_allclose(C, C.transpose(2, 3, 0, 1), rtol=0, atol=1e-12 * C.max())
    contacts, ratio = touching(dense), dense.law.stiffness_ratio
    n, b = contacts.normals, contacts.branches
    directions = (1 - ratio) * np.einsum("ci,ck->cik", n, n) + ratio * np.eye(3)
    kruyt = np.einsum("c,cik,cj,cl->ijkl", contacts.stiffness, directions, b, b) / dense.volume
    np.testing.assert_allclose(C, kruyt, rtol=0, atol=1e-9 * C.max())


# At rest, and from one state of rest to the next


def test_300_spheres_at_100_kpa(dense):
    sigma = stress(dense)
    np.testing.assert_allclose(sigma, -PRESSURE * np.eye(3), atol=1e-3 * PRESSURE)
    assert 5.5 < coordination_number(dense) < 6.5  # frictionless spheres jam at 6 less rattlers
    assert 0.5 < dense.void_ratio < 0.6
    contacts, net = touching(dense), np.zeros((300, 3))
    np.add.at(net, contacts.pairs[:, 0], contacts.forces)
    np.subtract.at(net, contacts.pairs[:, 1], contacts.forces)
    assert np.linalg.norm(net, axis=1).max() < 3e-3 * np.linalg.norm(contacts.forces, axis=1).max()


@pytest.mark.parametrize(("grains", "friction", "seed"), [(200, 0.0, 1), (200, 0.3, 1), (64, 0, 3)])
def test_small_packings_of_spheres_reach_their_stress_too(grains, friction, seed):
    """They are hundreds of times softer in shear than their contacts: shear stress stays long."""
    packing = random_packing(grains, compaction_friction=friction, seed=seed, dim=3)
    np.testing.assert_allclose(stress(packing), -PRESSURE * np.eye(3), atol=1e-3 * PRESSURE)


def test_the_same_seed_gives_the_same_bits_and_another_seed_another_packing():
    first, again, other = (random_packing(64, dim=3, seed=seed) for seed in (7, 7, 8))
    for name in ("box", "positions", "radii", "contacts", "tangential"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.positions, other.positions)


def test_the_stress_of_a_sheared_packing_at_rest_is_symmetric(dense):
    accuracy = PRESETS["balanced"].but(tolerance=1e-5, hold_limit=40000)
    response = Response(dense, 1, accuracy)
    F = np.eye(3) + 1e-3 * np.array([[0.5, 3.0, 0.0], [0.0, -1.0, 2.0], [1.0, 0.0, 0.3]])
    outcome = response.deform(F[None])
    assert outcome.at_rest[0]
    sigma = outcome.stress[0]
    assert np.abs(sigma - np.diag(np.diag(sigma))).max() > 1e-2 * np.abs(sigma).max()
    assert np.abs(sigma - sigma.T).max() < 1e-4 * np.abs(sigma).max()


def balance(packing, F: np.ndarray, increments: int) -> tuple[float, float]:
    """(work done on the packing, gain of elastic energy), J, over equal increments of F."""
    response = Response(packing, 1, SLOW)
    response.deform(np.eye(len(F))[None])
    response.commit()
    strain = logarithm(F[None])[0]
    start = elastic_energy(response.committed.packing(0))
    work, power = 0.0, []
    for _ in range(increments + 1):
        now = response.committed.packing(0)
        power.append(now.volume * (response.outcome.stress[0] * strain).sum())
        assert response.outcome.at_rest[0]
        if len(power) > 1:
            work += 0.5 * (power[-2] + power[-1])
        response.deform(F[None])
        response.commit()
    return work, elastic_energy(now) - start


@pytest.mark.parametrize("dim", [2, 3])
def test_without_dissipation_the_work_done_on_a_packing_is_the_energy_it_stores(dim):
    """Of lattices: a random packing of smooth grains rearranges sooner or later and dissipates."""
    packing = hexagonal_packing(64, law=LinearContact(modulus=6e8, friction=0.0), dim=dim)
    F = np.diag([1 - 1e-5, 1 - 3e-5, 1 - 2e-5][:dim])
    work, stored = balance(packing, F, 5)
    assert work > 0
    assert stored == pytest.approx(work, rel=1e-2)


@pytest.mark.parametrize("dim", [2, 3])
def test_work_that_a_sheared_packing_does_not_store_is_dissipated_by_friction(dim, dense):
    packing = reference_packing() if dim == 2 else dense
    F = np.eye(dim) + 2e-4 * np.diag([1.0, -1.0, 0.0][:dim])
    work, stored = balance(packing, F, 10)
    assert work > 0
    assert stored < work
    assert stored > 0.1 * work
