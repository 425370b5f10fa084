"""Spheres: pair list, conservation laws, and two of them in cases with a closed form."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.contacts import SCHEMES, LinearContact
from femxdem_fenicsx.dem.files import load_packing, save_packing
from femxdem_fenicsx.dem.homogenisation import elastic_energy, stress
from femxdem_fenicsx.dem.stability import stable_time_step
from tests.reference import reference_spheres

from .scenes import (
    FRICTIONLESS,
    RADIUS,
    STIFFNESS,
    Moving,
    loose_spheres,
    pairs_closer_than_reach_plus,
    turn,
    two_grains,
    two_spheres,
)

OVERLAP = 1e-4
PRESSED = STIFFNESS * OVERLAP  # N
DRIVEN = np.full(2, 1e-30)  # inverse masses so small that no force changes a velocity
OBLIQUE = np.array([0.6, -0.5, 0.9]) / np.linalg.norm([0.6, -0.5, 0.9])
ACROSS = np.cross(OBLIQUE, [1.0, 0.0, 0.0])
ACROSS /= np.linalg.norm(ACROSS)
NO_SPIN = np.zeros((2, 3))


def tangential(moving: Moving) -> np.ndarray:
    return moving.work.pairs.tangential[:, 0].copy()


def force_on_second(moving: Moving) -> np.ndarray:
    return moving.work.forces.grain[1, :3].copy()


def overlap_of(moving: Moving) -> float:
    branch = moving.work.motion.box @ np.diff(moving.work.motion.position)[:, 0]
    return moving.packing.radii.sum() - np.linalg.norm(branch)


# The pair list

SKEWED = np.array([[1.0, 0.8, -0.6], [0.0, 1.0, 0.7], [0.0, 0.0, 1.0]])
BOXES = {
    "cube": (150, 0.1 * np.eye(3)),
    "oblong": (100, np.diag([0.2, 0.05, 0.05])),
    "skewed": (150, 0.09 * SKEWED),
    "skewed and turned": (120, turn([1, 2, 3], 1.1) @ (0.09 * SKEWED.T)),
    "fewer than 3 cells along every side": (30, np.diag([0.035, 0.04, 0.032])),
    "fewer than 3 cells along one side": (60, np.diag([0.1, 0.034, 0.08])),
    "few and skewed": (40, 0.042 * np.array([[1.0, 0.5, 0.4], [0.0, 1.0, -0.5], [0, 0, 1]])),
    "two spheres": (2, 0.1 * np.eye(3)),
}


@pytest.mark.parametrize("case", BOXES)
@pytest.mark.parametrize("seed", range(2))
def test_the_list_holds_exactly_the_pairs_that_a_brute_force_search_finds(case, seed):
    grains, box = BOXES[case]
    moving = Moving(loose_spheres(grains, seed, box))
    expected = pairs_closer_than_reach_plus(
        moving.material.skin, box, moving.packing.positions, moving.packing.radii
    )
    assert expected or grains == 2
    pairs = moving.work.pairs
    assert {pair: tuple(pairs.shift[:, c]) for pair, c in moving.listed().items()} == expected
    if case == "two spheres":
        return
    used = slice(pairs.first[-1])
    positions = moving.packing.positions.T
    reduced = positions[:, pairs.j[used]] - positions[:, pairs.i[used]] + pairs.shift[:, used]
    normals = box @ reduced / np.linalg.norm(box @ reduced, axis=0)
    np.testing.assert_allclose(pairs.normal[:, used], normals, atol=1e-12)


def test_a_run_with_rebuilds_equals_one_whose_list_is_never_rebuilt():
    law = LinearContact(stiffness=1e4, friction=0.3)
    packing = loose_spheres(600, 8, 0.09 * SKEWED, law)
    settled = Moving(packing).advance(1000, 2e-5, damping=0.7).now
    gradient = np.array([[-0.4, 1.0, 0.3], [0.2, 0.5, -0.6], [0.5, 0.0, -0.1]])
    ends, rebuilt = [], []
    for skin in (settled.material.skin, 40 * settled.material.skin):
        moving = Moving(settled, skin=skin)
        anchor = moving.work.pairs.anchor_box[0, 0].copy()
        moving.advance(800, 2e-5, gradient, damping=0.3)
        rebuilt.append(moving.work.pairs.anchor_box[0, 0] != anchor)
        ends.append(moving.now)
    assert rebuilt == [True, False], "the first must rebuild its list, the second never"
    short, long = ends
    assert np.abs(short.positions - settled.positions).max() > 0.01  # grains did rearrange
    np.testing.assert_allclose(short.positions, long.positions, rtol=0, atol=1e-5)
    assert len(short.contacts) > 20
    np.testing.assert_allclose(
        stress(short), stress(long), rtol=0, atol=1e-3 * np.abs(stress(long)).max()
    )


# What is conserved


def kinetic_energy(moving: Moving) -> float:
    spin = 0.4 * (moving.work.motion.rim_velocity**2).sum(0)
    return 0.5 * float((moving.packing.masses * ((moving.velocity**2).sum(1) + spin)).sum())


def energy(moving: Moving, dt: float) -> tuple[float, float]:
    """(kinetic, elastic) J at the positions of now: velocities are known half a step off."""
    elastic, before = elastic_energy(moving.now), kinetic_energy(moving)
    moving.advance(1, dt)
    return 0.5 * (before + kinetic_energy(moving)), elastic


def test_energy_is_kept_without_friction_and_damping():
    packing = reference_spheres().but(law=LinearContact(modulus=6e8, friction=0.0))
    rng = np.random.default_rng(0)
    moving = Moving(packing, 0.1 * rng.normal(size=(packing.size, 3)))
    dt = 0.1 * stable_time_step(packing)
    samples = [energy(moving, dt)]
    for _ in range(40):
        moving.advance(249, dt)
        samples.append(energy(moving, dt))
    kinetic, elastic = np.array(samples).T
    total = kinetic + elastic
    assert np.ptp(kinetic) > 1e-2 * total[0], "energy must go back and forth for this to count"
    assert np.abs(total / total[0] - 1).max() < 1e-3


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("cohesion", [0.0, 2.0])
def test_momentum_is_kept_to_rounding(cohesion, scheme):
    law = LinearContact(
        stiffness=STIFFNESS, friction=0.4, cohesion=cohesion, viscous_damping=0.05, scheme=scheme
    )
    packing = loose_spheres(150, 5, 0.08 * SKEWED, law)
    rng = np.random.default_rng(3)
    moving = Moving(packing, rng.normal(size=(150, 3)), rng.normal(size=(150, 3)))
    masses = packing.masses[:, None]
    before = (masses * moving.velocity).sum(0)
    moving.advance(1000, 0.2 * stable_time_step(packing))
    scale = (masses * np.abs(moving.velocity)).sum()
    np.testing.assert_allclose((masses * moving.velocity).sum(0), before, atol=1e-12 * scale)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_angular_momentum_is_kept_to_rounding_by_spheres_that_rub(scheme):
    """Orbital plus spin, 2/5 m R^2 omega = 2/5 m R w with the rim velocity w."""
    law = LinearContact(stiffness=STIFFNESS, friction=0.5, scheme=scheme)
    packing = two_spheres(1e-5, law, (6e-3, 1e-2), OBLIQUE)
    velocity = np.array([np.zeros(3), 0.4 * ACROSS - OBLIQUE])
    moving = Moving(packing, velocity, [[0.2, -0.3, 0.1], [-0.5, 0.2, 0.4]])

    def momenta():
        x = moving.work.motion.position.T @ packing.box.T
        masses, w = packing.masses[:, None], moving.work.motion.rim_velocity.T
        return (
            np.cross(x, masses * moving.velocity).sum(0),
            0.4 * (masses * packing.radii[:, None] * w).sum(0),
        )

    before = momenta()
    moving.advance(20000, 1e-3 * stable_time_step(packing))
    after = momenta()
    assert (moving.velocity[1] - moving.velocity[0]) @ OBLIQUE > 0  # they have parted
    exchanged = np.linalg.norm(after[1] - before[1])
    assert exchanged > 1e-2 * packing.masses[0] * packing.radii[0] * 0.2
    np.testing.assert_allclose(sum(after), sum(before), rtol=0, atol=1e-8 * exchanged)


def test_a_rubbing_collision_changes_the_spin_by_the_impulse_over_two_fifths_of_the_mass():
    """Equal spheres, one tangential impulse J on each: m v' = J, 2/5 m w' = J at either rim."""
    law = LinearContact(stiffness=1e9, friction=0.1)  # so short that the normal does not turn
    packing = two_spheres(1e-8, law, direction=OBLIQUE)
    moving = Moving(packing, np.array([np.zeros(3), ACROSS - 0.1 * OBLIQUE]), NO_SPIN)
    moving.advance(6000, 1e-3 * stable_time_step(packing))
    assert overlap_of(moving) < 0
    lost = 1.0 - moving.velocity[1] @ ACROSS
    assert lost == pytest.approx(0.1 * 0.1, rel=5e-3)  # slides throughout
    spin = moving.work.motion.rim_velocity.T
    sense = np.cross(OBLIQUE, ACROSS)
    np.testing.assert_allclose(spin @ sense, 2.5 * lost, rtol=1e-2)


# Two spheres with a closed form


@pytest.mark.parametrize("radii", [(5e-3, 5e-3), (3e-3, 9e-3)])
@pytest.mark.parametrize("eta", [0.0, 0.1, 0.5])
def test_a_head_on_collision_gives_the_closed_form_restitution(radii, eta):
    """exp(-pi eta / sqrt(1 - eta^2)): half a period of the damped oscillator."""
    law = LinearContact(modulus=1e7, friction=0.0, viscous_damping=eta)
    packing = two_spheres(1e-5, law, radii, OBLIQUE)
    speed = 0.1
    moving = Moving(packing, np.array([0.3 * speed * OBLIQUE, -0.7 * speed * OBLIQUE]))
    dt = 1e-3 * stable_time_step(packing)
    moving.advance(int(np.ceil(2e-5 / speed / dt)) + 5000, dt)
    relative = moving.velocity[1] - moving.velocity[0]
    expected = np.exp(-np.pi * eta / np.sqrt(1 - eta**2))
    np.testing.assert_allclose(relative / speed, expected * OBLIQUE, atol=2e-3)


def test_the_normal_force_of_grains_of_two_sizes_is_the_modulus_times_the_harmonic_radius():
    packing = two_spheres(-1e-5, LinearContact(modulus=1e7), (4e-3, 8e-3), OBLIQUE)
    moving = Moving(packing, NO_SPIN, NO_SPIN, inverse_mass=DRIVEN).advance(1, 1e-7)
    stiffness = 1e7 * 2 * 4e-3 * 8e-3 / 12e-3
    np.testing.assert_allclose(force_on_second(moving), stiffness * 1e-5 * OBLIQUE, rtol=1e-9)
    np.testing.assert_allclose(moving.work.forces.grain[0, :3], -force_on_second(moving))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_sheared_contact_sticks_by_k_t_and_then_slides_at_mu_k_n(scheme):
    friction, ratio, speed, dt = 0.4, 0.8, 1e-3, 1e-5
    law = LinearContact(
        stiffness=STIFFNESS, stiffness_ratio=ratio, friction=friction, scheme=scheme
    )
    packing = two_spheres(-OVERLAP, law, direction=OBLIQUE)
    velocity = 0.5 * speed * np.array([-ACROSS, ACROSS])
    moving = Moving(packing, velocity, NO_SPIN, inverse_mass=DRIVEN)
    sliding_after = friction * PRESSED / (ratio * STIFFNESS * speed) / dt  # steps
    half = int(sliding_after / 2)
    moving.advance(half, dt)
    stuck = ratio * STIFFNESS * speed * half * dt
    np.testing.assert_allclose(tangential(moving), -stuck * ACROSS, rtol=0, atol=2e-3 * stuck)
    moving.advance(int(2 * sliding_after), dt)
    limit = friction * STIFFNESS * overlap_of(moving)
    np.testing.assert_allclose(tangential(moving), -limit * ACROSS, rtol=0, atol=1e-2 * limit)
    assert np.linalg.norm(tangential(moving)) == pytest.approx(limit, rel=1e-3)
    moving.velocity[:] *= -1  # back: it sticks at once
    moving.advance(half, dt)
    np.testing.assert_allclose(
        tangential(moving), (stuck - limit) * ACROSS, rtol=0, atol=2e-2 * limit
    )


def test_a_contact_that_opens_forgets_its_tangential_force():
    law = LinearContact(stiffness=STIFFNESS, friction=0.5)
    packing = two_spheres(-OVERLAP, law, direction=OBLIQUE)
    for scheme in SCHEMES:
        packing = packing.but(law=LinearContact(stiffness=STIFFNESS, friction=0.5, scheme=scheme))
        moving = Moving(packing, [np.zeros(3), 1e-3 * ACROSS], NO_SPIN, inverse_mass=DRIVEN)
        assert np.linalg.norm(tangential(moving.advance(100, 1e-5))) > 0
        moving.velocity[:] = [np.zeros(3), 1e-1 * OBLIQUE]
        moving.advance(150, 1e-5)  # 0.15 mm: open, still in the pair list
        assert len(moving.listed()) == 1
        assert not tangential(moving).any()
        assert not force_on_second(moving).any()


@pytest.mark.parametrize("axis", ["across", "third"])
def test_grains_that_roll_like_gears_do_not_slip_and_those_that_spin_alike_do(axis):
    law = LinearContact(stiffness=STIFFNESS, stiffness_ratio=1.0, friction=10.0)
    spin = ACROSS if axis == "across" else np.cross(OBLIQUE, ACROSS)
    packing = two_spheres(-OVERLAP, law, (0.7 * RADIUS, RADIUS), OBLIQUE)
    speed, steps, dt = 1e-3, 100, 1e-5
    rolling = Moving(packing, NO_SPIN, [speed * spin, -speed * spin], inverse_mass=DRIVEN)
    assert np.linalg.norm(tangential(rolling.advance(steps, dt))) < 1e-12 * PRESSED
    alike = Moving(packing, NO_SPIN, [speed * spin, speed * spin], inverse_mass=DRIVEN)
    alike.advance(steps, dt)
    lever = 1 - OVERLAP / (1.7 * RADIUS)
    expected = STIFFNESS * 2 * speed * lever * steps * dt * np.cross(spin, OBLIQUE)
    np.testing.assert_allclose(tangential(alike), expected, rtol=0, atol=1e-9 * 2 * PRESSED)
    moments = alike.work.forces.grain[:, 4:7]
    braking = -lever * np.cross(OBLIQUE, tangential(alike))
    np.testing.assert_allclose(moments, [braking, braking], rtol=1e-9, atol=1e-12)
    assert (moments @ spin < 0).all()


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_spheres_that_twist_about_their_normal_transmit_no_tangential_force(sense):
    law = LinearContact(stiffness=STIFFNESS, friction=0.5)
    packing = two_spheres(-OVERLAP, law, direction=OBLIQUE)
    spins = np.array([OBLIQUE, sense * OBLIQUE])
    moving = Moving(packing, NO_SPIN, spins, inverse_mass=DRIVEN).advance(200, 1e-5)
    assert np.linalg.norm(tangential(moving)) < 1e-12 * PRESSED
    assert np.abs(moving.work.forces.grain[:, 4:7]).max() < 1e-12 * PRESSED


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_tangential_force_turns_with_the_mean_spin_about_the_normal(scheme):
    law = LinearContact(stiffness=STIFFNESS, friction=100.0, scheme=scheme)
    packing = two_spheres(-OVERLAP, law, direction=OBLIQUE)
    packing = packing.but(contacts=[[0, 1]], tangential=[ACROSS])
    angle, steps = 0.7, 10000
    omegas = np.array([1.5, 0.5]) * angle  # their mean over a time of 1 s
    spins = omegas[:, None] * OBLIQUE * RADIUS
    moving = Moving(packing, NO_SPIN, spins, inverse_mass=DRIVEN).advance(steps, 1 / steps)
    np.testing.assert_allclose(tangential(moving), turn(OBLIQUE, angle) @ ACROSS, atol=5e-5)


def test_spheres_that_move_in_a_plane_answer_as_disks_do():
    for scheme in SCHEMES:
        law = LinearContact(
            stiffness=STIFFNESS, stiffness_ratio=0.7, friction=0.3, cohesion=0.4, scheme=scheme
        )
        radii, angle, dt = (0.7 * RADIUS, RADIUS), 0.9, 1e-6
        velocity = np.array([[2e-2, -1e-2], [-1e-2, 3e-2]])
        rims = np.array([1e-2, -3e-2])
        disks = Moving(two_grains(-OVERLAP, law, radii, angle), velocity, rims, inverse_mass=DRIVEN)
        packing = two_spheres(-OVERLAP, law, radii, (np.cos(angle), np.sin(angle), 0.0))
        spheres = Moving(
            packing, np.column_stack([velocity, [0, 0]]), np.outer(rims, [0, 0, 1]),
            inverse_mass=DRIVEN,
        )  # fmt: skip
        gradient = np.array([[0.3, -0.2], [0.1, -0.4]])
        embedded = np.zeros((3, 3))
        embedded[:2, :2] = gradient
        slid = []
        for _ in range(10):
            disks.advance(300, dt, gradient)
            spheres.advance(300, dt, embedded)
            expected = disks.work.forces.grain[1]
            force = spheres.work.forces.grain[1]
            np.testing.assert_allclose(force[:2], expected[:2], rtol=0, atol=1e-5 * PRESSED)
            assert force[6] == pytest.approx(expected[2], abs=1e-5 * PRESSED)
            assert not force[[2, 4, 5]].any()
            held = np.linalg.norm(tangential(spheres))
            assert held == pytest.approx(abs(disks.work.pairs.tangential[0, 0]), rel=1e-4)
            slid.append(held / (0.3 * STIFFNESS * overlap_of(spheres)))
        assert slid[0] < 0.9 and slid[-1] == pytest.approx(1, abs=2e-3)  # sticks, then slides


def test_spheres_without_friction_hold_no_tangential_force():
    packing = two_spheres(-OVERLAP, FRICTIONLESS, direction=OBLIQUE)
    moving = Moving(packing, [np.zeros(3), ACROSS], [ACROSS, OBLIQUE]).advance(50, 1e-6)
    assert not tangential(moving).any()
    np.testing.assert_array_equal(moving.work.motion.rim_velocity.T, [ACROSS, OBLIQUE])


# Files


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_packing_of_spheres_comes_back_bit_for_bit(tmp_path, scheme):
    law = LinearContact(modulus=6e8 / 7, friction=0.3, cohesion=1 / 7, scheme=scheme)
    packing = loose_spheres(40, 3, 0.08 * SKEWED, law).but(
        contacts=[[0, 4], [2, 7]], tangential=[[1 / 3, -np.pi, 0.1], [1e-3, 2 / 7, 0.0]]
    )
    save_packing(tmp_path / "spheres.h5", packing)
    back = load_packing(tmp_path / "spheres.h5", dim=3)
    for name in ("box", "positions", "radii", "contacts", "tangential"):
        np.testing.assert_array_equal(getattr(back, name), getattr(packing, name))
    assert (back.law, back.density, back.thickness) == (law, packing.density, 1.0)
    with pytest.raises(ValueError, match="3 dimensions, need 2"):
        load_packing(tmp_path / "spheres.h5")
