"""Regular packings against the closed forms of their lattices."""

from contextlib import suppress

import numpy as np
import pytest
from scipy.optimize import brentq

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.element_tests import drained_biaxial
from femxdem_fenicsx.dem.homogenisation import stress, touching
from femxdem_fenicsx.dem.lattices import hexagonal_packing
from femxdem_fenicsx.dem.mixed_control import NotReached
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


class Rows:
    """A hexagonal lattice compressed along the normal of its rows, under p along them.

    Two oblique contacts per disk, at theta to the rows, bear the load, and no disk turns. The
    lattice gives way when they slide and the contacts of the rows have opened: the ratio of the
    stresses is tan(theta) tan(theta + phi) then, phi the friction angle.
    """

    ratio, length = 0.8, 2 * RADIUS
    stiffness, load = MODULUS * RADIUS, PRESSURE * 20 * RADIUS  # k_n, p t

    def __init__(self, friction: float):
        self.friction, self.phi = friction, np.arctan(friction)
        d, k = self.length, self.stiffness
        self.first = brentq(lambda b: np.sqrt(3) * k * (d - b) - self.load * b, 0.5 * d, d)
        self.law = LinearContact(modulus=MODULUS, friction=friction, stiffness_ratio=self.ratio)

    def branch(self, theta: float) -> float:
        """Its length where the force has the inclination phi and p acts along the rows."""
        force = self.load * np.cos(self.phi) * np.sin(theta) / np.cos(theta + self.phi)
        return self.length / (1 + force / self.stiffness)

    def gap(self, theta: float) -> float:
        """Of the contacts in a row, where the oblique ones slide."""
        return 2 * self.branch(theta) * np.cos(theta) - self.length

    def tangential(self, theta: float) -> float:
        """What the turned branch has by elasticity, less what slides; the rows are open."""
        b = self.branch(theta)
        turned = self.ratio * self.stiffness * 0.5 * (b + self.first) * (np.pi / 3 - theta)
        return turned - self.friction * self.stiffness * (self.length - b)

    def gives_way(self) -> tuple[float, float]:
        """Strain and ratio of the stresses where both have happened, whichever is the second."""
        places = [brentq(f, np.pi / 3 - 0.2, np.pi / 3 - 1e-6) for f in (self.gap, self.tangential)]
        theta = min(places)
        strain = 1 - self.branch(theta) * np.sin(theta) / (self.first * np.sin(np.pi / 3))
        return strain, np.tan(theta) * np.tan(theta + self.phi)


@pytest.mark.parametrize(("friction", "at_least"), [(0.3, 6.9), (0.5, 20)])
def test_disks_give_way_where_the_oblique_contacts_slide_and_the_rows_have_opened(
    friction, at_least
):
    rows = Rows(friction)
    strain, strength = rows.gives_way()
    packing = hexagonal_packing(100, RADIUS, rows.law, PRESSURE)
    law = HomogenisedLaw(packing, 1, PRESETS["balanced"])
    states = []
    with suppress(NotReached):  # broken, it bears the pressure no more
        for state in drained_biaxial(law, PRESSURE, 1.15 * strain, 1e-3):
            states.append(state)
    ratios = np.array([state.stress[1, 1] / state.stress[0, 0] for state in states])
    peak = states[int(ratios.argmax())]
    assert ratios.max() == pytest.approx(strength, rel=0.03) and strength > at_least
    assert peak.axial_strain == pytest.approx(strain, abs=1e-3)
