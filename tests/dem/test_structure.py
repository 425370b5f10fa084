"""Contacts per grain, rattlers, and the numbers that describe a packing."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.homogenisation import touching
from femxdem_fenicsx.dem.structure import contact_numbers, rattlers, structure_of
from tests.dem.scenes import FRICTIONLESS, chain, hexagonal

ROUGH = LinearContact(stiffness=1e5, friction=0.5)


def with_small_grain(packing, grain: int):
    radii = packing.radii.copy()
    radii[grain] *= 0.9
    return packing.but(radii=radii)


def test_every_grain_of_a_triangular_lattice_has_six_contacts_and_a_small_one_none():
    packing = hexagonal()
    assert (contact_numbers(packing) == 6).all()
    numbers = contact_numbers(with_small_grain(packing, 8))
    assert numbers[8] == 0 and np.bincount(numbers)[5] == 6 and np.bincount(numbers)[6] == 29


def test_a_grain_that_touches_nothing_is_a_rattler_and_its_neighbours_are_none():
    free = rattlers(with_small_grain(hexagonal(), 8))
    np.testing.assert_array_equal(np.flatnonzero(free), [8])


def test_two_contacts_hold_a_grain_with_friction_but_not_without():
    assert not rattlers(chain(0, ROUGH)).any()
    assert rattlers(chain(0, FRICTIONLESS)).all()


def test_a_chain_that_is_broken_bears_nothing_down_to_its_last_grain():
    assert rattlers(with_small_grain(chain(0, ROUGH, grains=8), 3)).all()


def test_the_structure_of_a_lattice_with_one_rattler():
    packing = with_small_grain(hexagonal(law=ROUGH), 8)
    found = structure_of(packing)
    assert found.void_ratio == packing.void_ratio
    assert found.coordination_number == pytest.approx(2 * 102 / 36)
    assert found.bearing_coordination_number == pytest.approx(2 * 102 / 35)
    assert found.rattlers == pytest.approx(1 / 36)
    assert found.fabric_anisotropy < 1e-12 and found.sliding == 0.0
    assert found.largest_overlap == pytest.approx(1e-3)


def test_contacts_at_the_coulomb_limit_slide():
    packing = hexagonal(law=ROUGH)
    contacts = touching(packing)
    forces = np.zeros(len(contacts.pairs))
    forces[:10] = 0.5 * contacts.normal_force[:10]
    packing = packing.but(contacts=contacts.pairs, tangential=forces)
    assert structure_of(packing).sliding == pytest.approx(10 / len(contacts.pairs))
