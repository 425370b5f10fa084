"""The stable time step against eigenvalues in closed form and of the whole network."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.homogenisation import touching
from femxdem_fenicsx.dem.stability import stable_time_step
from tests.reference import reference_packing

from .scenes import FRICTIONLESS, STIFFNESS, Moving, chain, hexagonal, two_grains

RATIO = 0.7
STICKING = LinearContact(stiffness=STIFFNESS, stiffness_ratio=RATIO, friction=0.5)


@pytest.mark.parametrize(
    ("packing", "frequency_squared"),
    [
        (two_grains(-1e-4), 2.0),
        (two_grains(-1e-4, angle=0.6), 2.0),
        (two_grains(-1e-4, STICKING), 6 * RATIO),  # both grains spin against the contact
        (chain(0, FRICTIONLESS), 4.0),  # neighbours swing against each other
        (chain(1, STICKING), 8 * RATIO),  # all spin the same way
        (hexagonal(), 6.0),  # lattice sums over the six neighbours
    ],
    ids=["pair", "turned pair", "sticking pair", "chain", "sticking chain", "hexagonal"],
)
def test_the_limit_of_a_small_network_is_the_closed_form(packing, frequency_squared):
    """omega^2 in k_n / m; the limit of the leapfrog is 2 / omega."""
    omega = np.sqrt(frequency_squared * STIFFNESS / packing.masses[0])
    assert stable_time_step(packing) == pytest.approx(2 / omega, rel=1e-3)


@pytest.fixture(scope="module")
def packing():
    return reference_packing()


def test_the_limit_of_400_disks_is_that_of_the_eigenvalues_of_their_network(packing):
    contacts = touching(packing)
    size, ratio = packing.size, packing.law.stiffness_ratio
    rows = np.zeros((2 * len(contacts.pairs), 3 * size))  # displacements -> (normal, slip)
    stiffness = np.repeat(contacts.stiffness, 2) * np.tile([1.0, ratio], len(contacts.pairs))
    for k, (i, j) in enumerate(contacts.pairs):
        n = contacts.normals[k]
        t = np.array([-n[1], n[0]])
        rows[2 * k, [3 * i, 3 * i + 1, 3 * j, 3 * j + 1]] = [*-n, *n]
        rows[2 * k + 1, [3 * i, 3 * i + 1, 3 * j, 3 * j + 1]] = [*-t, *t]
        rows[2 * k + 1, [3 * i + 2, 3 * j + 2]] = -1.0  # rim displacements
    inertia = np.column_stack([packing.masses, packing.masses, packing.masses / 2]).ravel()
    scaled = rows / np.sqrt(inertia)
    largest = np.linalg.eigvalsh((scaled.T * stiffness) @ scaled)[-1]
    assert stable_time_step(packing) == pytest.approx(2 / np.sqrt(largest), rel=2e-3)


@pytest.mark.parametrize("friction", [True, False])
def test_eight_tenths_of_the_limit_come_to_rest_and_twice_the_limit_blows_up(packing, friction):
    if not friction:
        packing = packing.but(law=LinearContact(modulus=packing.law.modulus, friction=0.0))
    limit = stable_time_step(packing)
    velocity = 0.01 * np.random.default_rng(0).normal(size=(400, 2))

    def motion_after(share):
        moving = Moving(packing, velocity).advance(5000, share * limit, damping=0.3)
        return np.sqrt((moving.velocity**2).mean())

    assert motion_after(0.8) < 0.1 * 0.01
    assert motion_after(2.0) > 100 * 0.01


def test_a_packing_without_contacts_is_given_a_limit_that_holds_once_they_touch():
    dilute = hexagonal(overlap=-0.05, law=STICKING)
    limit = stable_time_step(dilute)
    assert 0 < limit < stable_time_step(hexagonal(law=STICKING))
    moving = Moving(dilute, 0.1 * np.random.default_rng(0).normal(size=(36, 2)))
    before = (moving.velocity**2).sum()
    moving.advance(20000, limit)
    assert (moving.velocity**2).sum() < before  # it collides, and heats up by none of it


def test_the_limit_scales_with_mass_and_stiffness():
    packing = hexagonal(law=STICKING)
    heavier = packing.but(density=4 * packing.density)
    assert stable_time_step(heavier) == pytest.approx(2 * stable_time_step(packing), rel=1e-4)
