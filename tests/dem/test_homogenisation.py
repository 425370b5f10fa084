"""Averages over contacts against YADE's and closed forms."""

import numpy as np
import pytest

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
from tests.reference import packing_from_tables, reference_packing, table

from .scenes import FRICTIONLESS, RADIUS, STIFFNESS, Moving, chain, hexagonal, loose, two_grains


@pytest.fixture(scope="module")
def yade():
    return packing_from_tables()


def test_stress_of_yades_packing_is_what_yade_computed(yade):
    expected = [[-100028.5, 617.4], [617.4, -99924.3]]
    np.testing.assert_allclose(stress(yade), expected, rtol=0, atol=0.1)  # 1e-6 of 100 kPa


def test_yades_packing_has_its_contacts_and_void_ratio(yade):
    assert len(touching(yade).pairs) == 832
    assert coordination_number(yade) == pytest.approx(4.16)
    assert yade.void_ratio == pytest.approx(0.1750, abs=5e-5)


def test_every_contact_of_yades_packing_is_found_with_its_force_and_direction(yade):
    contacts, rows = touching(yade), table("contacts.csv")
    ours = {tuple(pair): k for k, pair in enumerate(contacts.pairs)}
    order, sign = [], []
    for row in rows:
        pair = int(row["id1"]), int(row["id2"])
        order.append(ours[tuple(sorted(pair))])
        sign.append(1 if pair[0] < pair[1] else -1)
    assert len(set(order)) == len(ours) == len(rows)
    np.testing.assert_allclose(contacts.stiffness[order], rows["kn_N_per_m"], rtol=1e-12)
    np.testing.assert_allclose(contacts.normal_force[order], rows["fn_N"], rtol=1e-6, atol=1e-6)
    normals = np.column_stack([rows["nx"], rows["ny"]])
    np.testing.assert_allclose(
        np.array(sign)[:, None] * contacts.normals[order], normals, rtol=0, atol=1e-9
    )


def test_the_packing_file_of_demos_and_benchmarks_is_yades_packing(yade):
    stored = reference_packing()
    for name in ("box", "positions", "radii", "contacts", "tangential"):
        np.testing.assert_array_equal(getattr(stored, name), getattr(yade, name))
    assert stored.law == yade.law
    assert (stored.density, stored.thickness) == (yade.density, yade.thickness)


def test_a_hexagonal_packing_carries_the_closed_form_pressure_with_an_isotropic_fabric():
    overlap = 1e-3
    packing = hexagonal(overlap=overlap)
    contacts = touching(packing)
    spacing = 2 * RADIUS * (1 - overlap)
    force = STIFFNESS * 2 * RADIUS * overlap
    pressure = np.sqrt(3) * force / (spacing * packing.thickness)
    np.testing.assert_allclose(stress(packing), -pressure * np.eye(2), atol=1e-9 * pressure)
    np.testing.assert_allclose(fabric(contacts), np.eye(2) / 2, atol=1e-12)
    assert fabric_anisotropy(fabric(contacts)) == pytest.approx(0, abs=1e-12)
    assert coordination_number(packing) == 6
    area_ratio = 2 * np.sqrt(3) * (1 - overlap) ** 2 / np.pi
    assert packing.void_ratio == pytest.approx(area_ratio - 1)


def test_contacts_along_one_axis_have_a_fabric_anisotropy_of_two():
    phi = fabric(touching(chain(0, FRICTIONLESS)))
    np.testing.assert_allclose(phi, [[1, 0], [0, 0]], atol=1e-15)
    assert fabric_anisotropy(phi) == pytest.approx(2)


@pytest.mark.parametrize("axis", [0.0, 0.5])
def test_fabric_anisotropy_is_the_amplitude_of_the_density_of_normals(axis):
    """E(theta) = (1 + a cos 2 (theta - axis)) / 2 pi has F_a = a (Guo-Zhao eq. 23-25)."""
    amplitude, theta = 0.37, np.linspace(0, 2 * np.pi, 360, endpoint=False)
    n = np.column_stack([np.cos(theta), np.sin(theta)])
    density = 1 + amplitude * np.cos(2 * (theta - axis))
    phi = np.einsum("k,ki,kj->ij", density, n, n) / len(theta)
    assert fabric_anisotropy(phi) == pytest.approx(amplitude)
    np.testing.assert_allclose(fabric_anisotropy(np.array([phi, np.eye(2) / 2])), [amplitude, 0])


def test_a_packing_without_contacts_has_no_stress_and_an_isotropic_fabric():
    packing = two_grains(1e-3)
    assert (stress(packing) == 0).all()
    assert coordination_number(packing) == 0
    assert fabric_anisotropy(fabric(touching(packing))) == 0
    assert elastic_energy(packing) == 0


def test_tangential_forces_count_in_stress_and_energy():
    law = LinearContact(stiffness=STIFFNESS, stiffness_ratio=0.5, friction=0.5)
    packing = two_grains(-1e-4, law).but(contacts=[[0, 1]], tangential=[2.0])
    normal, branch = STIFFNESS * 1e-4, 2 * RADIUS - 1e-4
    expected = np.array([[-normal, 0], [-2.0, 0]]) * branch / packing.volume
    np.testing.assert_allclose(stress(packing), expected, rtol=1e-9)
    energy = 0.5 * STIFFNESS * 1e-8 + 0.5 * 2.0**2 / (0.5 * STIFFNESS)
    assert elastic_energy(packing) == pytest.approx(energy)


def test_cohesion_pulls_on_the_boundary_of_a_packing():
    law = LinearContact(stiffness=STIFFNESS, friction=0.0, cohesion=50.0)
    without, with_it = stress(hexagonal()), stress(hexagonal(law=law))
    assert with_it[0, 0] - without[0, 0] == pytest.approx(
        np.sqrt(3) * 50.0 / (2 * RADIUS * 0.999 * 0.1)
    )


def test_stress_times_volume_is_the_derivative_of_the_elastic_energy():
    packing = loose(150, 8, 0.12 * np.array([[1.0, 0.3], [0.0, 1.0]]))
    h = 1e-6
    for k in range(2):
        for m in range(2):
            F = np.zeros((2, 2))
            F[k, m] = h
            plus, minus = (packing.deformed(np.eye(2) + s * F) for s in (1, -1))
            slope = (elastic_energy(plus) - elastic_energy(minus)) / (2 * h)
            scale = np.abs(stress(packing)).max()
            assert slope / packing.volume == pytest.approx(stress(packing)[k, m], abs=1e-6 * scale)


@pytest.mark.parametrize("cohesion", [0.0, 5.0])
def test_the_kernel_measures_what_the_arrays_say(cohesion):
    law = LinearContact(stiffness=1e4, friction=0.4, cohesion=cohesion)
    packing = loose(200, 5, 0.14 * np.array([[1.0, 0.3], [0.0, 1.0]]), law)
    moving = Moving(packing).advance(300, 2e-5, [[0.5, 1.0], [0.0, -0.5]], 0.5)
    sigma, phi = np.ones((2, 2)), np.ones((2, 2))
    count, overlap = measure(
        moving.work.motion, moving.work.pairs, law.elasticity, moving.material.cohesion, None,
        packing.thickness, sigma, phi,
    )  # fmt: skip
    now = moving.now
    contacts = touching(now)
    assert np.abs(contacts.tangential).max() > 0
    assert count == len(contacts.pairs)
    np.testing.assert_allclose(sigma, stress(now), rtol=1e-9, atol=1e-9 * np.abs(sigma).max())
    np.testing.assert_allclose(phi, fabric(contacts), rtol=1e-9, atol=1e-12)
    i, j = contacts.pairs.T
    expected = contacts.overlaps / (now.radii[i] + now.radii[j])
    assert overlap == pytest.approx(expected.max())
