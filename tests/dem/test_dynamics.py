"""Time steps: what they conserve, and collisions with a closed form."""

import numpy as np
import pytest

from femxdem_fenicsx.dem import dynamics
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.homogenisation import elastic_energy, stress
from femxdem_fenicsx.dem.stability import stable_time_step
from tests.reference import reference_packing

from .scenes import FRICTIONLESS, STIFFNESS, Moving, loose, two_grains


@pytest.fixture(scope="module")
def frictionless():
    """YADE's 400 disks at 100 kPa without friction."""
    packing = reference_packing()
    law = LinearContact(modulus=packing.law.modulus, friction=0.0)
    return packing.but(law=law)


def kinetic_energy(moving: Moving) -> float:
    linear = moving.packing.masses * (moving.velocity**2).sum(1)
    spin = 0.5 * moving.packing.masses * moving.work.motion.rim_velocity[0] ** 2
    return 0.5 * float((linear + spin).sum())


def energy(moving: Moving, dt: float) -> tuple[float, float]:
    """(kinetic, elastic) J at the positions of now: velocities are known half a step off."""
    elastic, before = elastic_energy(moving.now), kinetic_energy(moving)
    moving.advance(1, dt)
    return 0.5 * (before + kinetic_energy(moving)), elastic


@pytest.mark.parametrize(("speed", "time_step"), [(0.05, 0.2), (0.3, 0.05)])
def test_energy_is_kept_over_1e5_steps_without_friction_and_damping(frictionless, speed, time_step):
    rng = np.random.default_rng(0)
    moving = Moving(frictionless, speed * rng.normal(size=(400, 2)))
    dt = time_step * stable_time_step(frictionless)
    samples = [energy(moving, dt)]
    for _ in range(100):
        moving.advance(999, dt)
        samples.append(energy(moving, dt))
    kinetic, elastic = np.array(samples).T
    total = kinetic + elastic
    assert np.ptp(kinetic) > 5e-3 * total[0], "energy must go back and forth for this to count"
    assert np.abs(total / total[0] - 1).max() < 1e-3


def test_local_damping_and_viscosity_take_energy_out(frictionless):
    viscous = frictionless.but(law=LinearContact(modulus=6e8, friction=0.0, viscous_damping=0.1))
    rng = np.random.default_rng(0)
    velocity = 0.05 * rng.normal(size=(400, 2))
    dt = 0.2 * stable_time_step(frictionless)
    for packing, damping in ((frictionless, 0.3), (viscous, 0.0)):
        moving = Moving(packing, velocity)
        before = kinetic_energy(moving)
        assert kinetic_energy(moving.advance(6000, dt, damping=damping)) < 1e-2 * before


def test_friction_takes_energy_out_where_grains_slide():
    law = LinearContact(stiffness=STIFFNESS, friction=0.3)
    packing = two_grains(1e-4, law)
    moving = Moving(packing, [[0, 0], [-1.0, 1.0]])
    dt = 0.01 * stable_time_step(packing)
    before = sum(energy(moving, dt))
    moving.advance(4000, dt)
    assert not moving.now.contacts.size
    after = sum(energy(moving, dt))
    assert 0.5 * before < after < 0.99 * before


@pytest.mark.parametrize("cohesion", [0.0, 2.0])
def test_momentum_is_kept_to_rounding(cohesion):
    law = LinearContact(stiffness=STIFFNESS, friction=0.4, cohesion=cohesion, viscous_damping=0.05)
    box = 0.15 * np.array([[1.0, 0.3], [0.0, 1.0]])
    rng = np.random.default_rng(3)
    packing = loose(200, 5, box, law)
    moving = Moving(packing, rng.normal(size=(200, 2)), rng.normal(size=200))
    masses = packing.masses[:, None]
    before = (masses * moving.velocity).sum(0)
    moving.advance(2000, 0.2 * stable_time_step(packing))
    scale = (masses * np.abs(moving.velocity)).sum()
    np.testing.assert_allclose((masses * moving.velocity).sum(0), before, atol=1e-12 * scale)


def test_angular_momentum_is_kept_by_grains_that_rub():
    """Orbital plus spin, m R^2 omega / 2 = m R w / 2 with the rim speed w."""
    law = LinearContact(stiffness=STIFFNESS, friction=0.5)
    packing = two_grains(1e-5, law, radii=(6e-3, 1e-2), angle=0.3)
    along, across = np.array([np.cos(0.3), np.sin(0.3)]), np.array([-np.sin(0.3), np.cos(0.3)])
    moving = Moving(packing, np.array([0.0 * along, 0.4 * across - along]), [0.2, -0.5])

    def momenta():
        x = moving.work.motion.position.T @ packing.box.T
        v, w = moving.velocity, moving.work.motion.rim_velocity[0]
        orbital = packing.masses * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])
        return orbital.sum(), 0.5 * (packing.masses * packing.radii * w).sum()

    before = momenta()
    moving.advance(20000, 1e-3 * stable_time_step(packing))
    after = momenta()
    assert (moving.velocity[1] - moving.velocity[0]) @ along > 0  # they have parted
    exchanged = after[1] - before[1]
    assert abs(exchanged) > 1e-2 * packing.masses[0] * packing.radii[0] * 0.2
    assert sum(after) == pytest.approx(sum(before), abs=1e-3 * abs(exchanged))


def test_affine_motion_of_the_box_gives_no_grain_momentum(frictionless):
    moving = Moving(frictionless)
    dt = 0.5 * stable_time_step(frictionless)
    moving.advance(500, dt, [[0.5, 0.3], [-0.1, -0.5]])
    momentum = (frictionless.masses[:, None] * moving.velocity).sum(0)
    scale = (frictionless.masses[:, None] * np.abs(moving.velocity)).sum()
    assert scale > 0
    assert np.abs(momentum).max() < 1e-11 * scale


@pytest.mark.parametrize("radii", [(5e-3, 5e-3), (3e-3, 9e-3)])
@pytest.mark.parametrize("angle", [0.0, 2.0])
@pytest.mark.parametrize("eta", [0.0, 0.1, 0.5])
def test_a_head_on_collision_gives_the_closed_form_restitution(radii, angle, eta):
    """exp(-pi eta / sqrt(1 - eta^2)): half a period of the damped oscillator."""
    law = LinearContact(modulus=1e7, friction=0.0, viscous_damping=eta)
    packing = two_grains(1e-5, law, radii, angle)
    along = np.array([np.cos(angle), np.sin(angle)])
    speed = 0.1
    moving = Moving(packing, np.array([0.3 * speed * along, -0.7 * speed * along]))
    dt = 1e-3 * stable_time_step(packing)
    moving.advance(int(np.ceil(2e-5 / speed / dt)) + 5000, dt)
    relative = moving.velocity[1] - moving.velocity[0]
    expected = np.exp(-np.pi * eta / np.sqrt(1 - eta**2))
    np.testing.assert_allclose(relative / speed, expected * along, atol=2e-3)


def test_two_grains_swing_at_their_eigenfrequency():
    packing = two_grains(-1e-4)
    limit = np.sqrt(2 * packing.masses[0] / STIFFNESS)  # 2 / omega, omega^2 = 2 k / m
    moving = Moving(packing)
    dt = 1e-2 * limit
    steps = round(0.5 * np.pi * limit / 2 / dt)  # a quarter of a period: force is gone
    moving.advance(steps, dt)
    overlap = moving.packing.radii.sum() - np.linalg.norm(
        packing.box @ np.diff(moving.work.motion.position)[:, 0]
    )
    assert abs(overlap) < 0.02 * 1e-4


def test_a_frictionless_packing_holds_no_tangential_force(frictionless):
    moving = Moving(frictionless)
    moving.advance(2000, 0.5 * stable_time_step(frictionless), [[0.0, 0.5], [0.0, 0.0]], 0.3)
    assert abs(stress(moving.now)[0, 0]) > 1e3
    assert len(moving.now.contacts) == 0
    assert not moving.work.pairs.tangential.any()
    assert not moving.work.motion.rim_velocity.any()


def test_features_that_are_off_are_compiled_away():
    """Numba prunes `if friction is not None` where the argument's type is None."""

    def compiled_for(**features) -> set:
        law = LinearContact(stiffness=STIFFNESS, **{"friction": 0.0, **features})
        Moving(two_grains(-1e-4, law)).advance(1, 1e-6)
        kinds = set()
        for signature in dynamics.advance.signatures:
            material = dict(zip(signature[4].fields, signature[4].types, strict=True))
            kinds.add(tuple(str(material[n]) for n in ("friction", "cohesion", "viscosity")))
        return kinds

    assert ("none", "none", "none") in compiled_for()
    assert ("float64", "none", "none") in compiled_for(friction=0.5)
    assert ("none", "float64", "none") in compiled_for(cohesion=1.0)


def test_the_box_follows_the_exponential_of_the_velocity_gradient():
    L = np.array([[0.3, -1.1], [0.7, -0.2]])
    moving = Moving(two_grains(0.01, FRICTIONLESS)).advance(1000, 1e-3, L)
    values, vectors = np.linalg.eig(L)
    exponential = (vectors @ np.diag(np.exp(values)) @ np.linalg.inv(vectors)).real
    np.testing.assert_allclose(moving.work.motion.box, exponential @ moving.packing.box, rtol=1e-11)
    assert not moving.velocity.any()  # grains follow the box, and nothing else moves them
