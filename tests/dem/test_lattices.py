"""Regular packings against the closed forms of their lattices."""

import numpy as np
import pytest
from scipy.optimize import brentq

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.element_tests import drained_biaxial
from femxdem_fenicsx.dem.homogenisation import stress, touching
from femxdem_fenicsx.dem.lattices import hexagonal_packing
from femxdem_fenicsx.dem.structure import structure_of
from femxdem_fenicsx.homogenised_law import HomogenisedLaw

RADIUS, MODULUS, PRESSURE = 5e-3, 6e8, 1e5
LAW = LinearContact(modulus=MODULUS, friction=0.5)


@pytest.fixture(scope="module")
def disks():
    return hexagonal_packing(100, RADIUS, LAW, PRESSURE, tolerance=1e-5)


def test_disks_have_six_neighbours_and_the_force_that_the_pressure_asks_for(disks):
    found, contacts = structure_of(disks), touching(disks)
    assert found.coordination_number == 6 and found.rattlers == 0
    assert found.fabric_anisotropy < 1e-9
    # p = sqrt(3) f / (l t): three contacts per disk, l^2 sqrt(3) / 2 of area
    length = np.linalg.norm(contacts.branches, axis=1)
    expected = PRESSURE * length * disks.thickness / np.sqrt(3)
    np.testing.assert_allclose(contacts.normal_force, expected, rtol=2e-5)
    np.testing.assert_allclose(stress(disks), -PRESSURE * np.eye(2), atol=2e-5 * PRESSURE)
    assert disks.size >= 100 and max(disks.box[0, 0], disks.box[1, 1]) < 1.2 * min(
        disks.box[0, 0], disks.box[1, 1]
    )


def test_spheres_have_twelve_neighbours_and_the_closest_packing():
    packing = hexagonal_packing(108, RADIUS, LAW, PRESSURE, dim=3, tolerance=1e-5)
    found, contacts = structure_of(packing), touching(packing)
    assert packing.size == 108 and found.coordination_number == 12
    # p = 2 sqrt(2) f / l^2: six contacts per sphere, l^3 / sqrt(2) of volume
    length = np.linalg.norm(contacts.branches, axis=1)
    np.testing.assert_allclose(
        contacts.normal_force, PRESSURE * length**2 / (2 * np.sqrt(2)), rtol=2e-5
    )
    overlap = 1 - length.mean() / (2 * RADIUS)
    void_ratio = (1 - overlap) ** 3 * 3 * np.sqrt(2) / np.pi - 1
    assert packing.void_ratio == pytest.approx(void_ratio, rel=1e-6)


def test_unequal_pressures_are_borne_axis_by_axis():
    packing = hexagonal_packing(64, RADIUS, LAW, (1e5, 1.5e5))
    np.testing.assert_allclose(np.diag(stress(packing)), (-1e5, -1.5e5), rtol=2e-3)


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"grains": 0}, "1 grain"),
        ({"radius": -1.0}, "radius"),
        ({"dim": 4}, "dimensions"),
        ({"grains": 2}, "more grains"),
        ({"pressure": -1.0}, "pressure"),
    ],
)
def test_what_makes_no_lattice_is_refused(values, complaint):
    with pytest.raises(ValueError, match=complaint):
        hexagonal_packing(**values)


def test_disks_break_where_the_oblique_contacts_slide():
    """Rows of a hexagonal lattice compressed along their normal, under a pressure p along them.

    The contacts of a row open. What is left, two contacts per disk at theta to the rows, bears
    sigma_1 / sigma_3 = tan(theta) tan(theta + phi) where it slides, phi the friction angle. Until
    then nothing turns, and the tangential force is k_t times what the branch has turned.
    """
    friction, ratio, length = 0.3, 0.8, 2 * RADIUS
    law = LinearContact(modulus=MODULUS, friction=friction, stiffness_ratio=ratio)
    stiffness, load = MODULUS * RADIUS, PRESSURE * 20 * RADIUS  # k_n, p t
    phi = np.arctan(friction)
    first = brentq(lambda b: np.sqrt(3) * stiffness * (length - b) - load * b, 0.5 * length, length)

    def branch(theta: float) -> float:
        """Its length where its force has the inclination phi, and p along the rows."""
        force = load * np.cos(phi) * np.sin(theta) / np.cos(theta + phi)
        return length / (1 + force / stiffness)

    def tangential(theta: float) -> float:
        """What the turned branch has, less what slides."""
        b = branch(theta)
        turned = ratio * stiffness * 0.5 * (b + first) * (np.pi / 3 - theta)
        return turned - friction * stiffness * (length - b)

    theta = brentq(tangential, np.pi / 3 - 0.3, np.pi / 3 - 1e-6)
    strain = 1 - branch(theta) * np.sin(theta) / (first * np.sin(np.pi / 3))
    strength = np.tan(theta) * np.tan(theta + phi)

    packing = HomogenisedLaw(hexagonal_packing(100, RADIUS, law, PRESSURE), 1, PRESETS["balanced"])
    states = list(drained_biaxial(packing, PRESSURE, 1.2 * strain, 5e-4))
    ratios = [state.stress[1, 1] / state.stress[0, 0] for state in states]
    peak = int(np.argmax(ratios))
    assert ratios[peak] == pytest.approx(strength, rel=0.02) and strength > 7
    assert states[peak].axial_strain == pytest.approx(strain, abs=1e-3)
