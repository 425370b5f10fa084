"""Parameters of the contact law, and the forces of two grains driven by hand."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.contacts import LinearContact

from .scenes import RADIUS, STIFFNESS, Moving, two_grains

OVERLAP = 1e-4
PRESSED = STIFFNESS * OVERLAP  # N
DRIVEN = np.full(2, 1e-30)  # inverse masses so small that no force changes a velocity


def driven(law: LinearContact, velocity=0.0, rim_speed=0.0, gap=-OVERLAP, angle=0.0) -> Moving:
    """Two grains that keep velocities given along and across their branch."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    velocity = (np.zeros((2, 2)) + velocity) @ turn.T
    return Moving(two_grains(gap, law, angle=angle), velocity, rim_speed, inverse_mass=DRIVEN)


def tangential(moving: Moving) -> float:
    return float(moving.work.pairs.tangential[0, 0])


def force_on_second(moving: Moving) -> np.ndarray:
    return moving.work.forces.grain[1, :2].copy()


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({}, "either stiffness"),
        ({"stiffness": 1e5, "modulus": 1e8}, "either stiffness"),
        ({"stiffness": 0.0}, "positive"),
        ({"stiffness": -1e5}, "positive"),
        ({"modulus": float("nan")}, "positive"),
        ({"modulus": float("inf")}, "positive"),
        ({"stiffness": 1e5, "friction": -0.1}, "friction"),
        ({"stiffness": 1e5, "friction": float("nan")}, "friction"),
        ({"stiffness": 1e5, "cohesion": -1.0}, "cohesion"),
        ({"stiffness": 1e5, "stiffness_ratio": -0.5}, "stiffness_ratio"),
        ({"stiffness": 1e5, "viscous_damping": 1.0}, "viscous_damping"),
        ({"stiffness": 1e5, "viscous_damping": -0.1}, "viscous_damping"),
    ],
)
def test_parameters_that_make_no_contact_are_refused_by_name(values, complaint):
    with pytest.raises(ValueError, match=complaint):
        LinearContact(**values)


def test_features_that_are_off_are_none():
    assert LinearContact(stiffness=1.0, friction=0.0).features == (None, None, None)
    law = LinearContact(stiffness=1.0, friction=0.2, cohesion=3.0, viscous_damping=0.1)
    assert law.features == (0.2, 3.0, 0.1)


@pytest.mark.parametrize("angle", [0.0, 1.1, -2.5])
def test_normal_force_is_stiffness_times_overlap_and_pushes_apart(angle):
    moving = driven(LinearContact(stiffness=STIFFNESS, friction=0.0), angle=angle).advance(1, 1e-6)
    expected = PRESSED * np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(force_on_second(moving), expected, rtol=1e-9)
    np.testing.assert_allclose(moving.work.forces.grain[0, :2], -expected, rtol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 0.9])
def test_a_sheared_contact_sticks_by_k_t_and_then_slides_at_mu_k_n(angle):
    friction, ratio, speed, dt = 0.4, 0.8, 1e-3, 1e-5
    law = LinearContact(stiffness=STIFFNESS, stiffness_ratio=ratio, friction=friction)
    moving = driven(law, [[0, -speed / 2], [0, speed / 2]], angle=angle)
    sliding_after = friction * PRESSED / (ratio * STIFFNESS * speed) / dt  # steps
    half = int(sliding_after / 2)
    moving.advance(half, dt)
    assert tangential(moving) == pytest.approx(-ratio * STIFFNESS * speed * half * dt, rel=1e-4)
    across = np.array([-np.sin(angle), np.cos(angle)])
    assert force_on_second(moving) @ across == pytest.approx(tangential(moving), rel=1e-2)
    moving.advance(int(2 * sliding_after), dt)
    overlap = 2 * RADIUS - np.linalg.norm(
        moving.packing.box @ (np.diff(moving.work.motion.position)[:, 0])
    )
    limit = friction * STIFFNESS * overlap
    assert tangential(moving) == pytest.approx(-limit, rel=1e-3)
    moving.velocity[:] *= -1  # back: it sticks at once
    moving.advance(half, dt)
    change = ratio * STIFFNESS * speed * half * dt
    assert tangential(moving) == pytest.approx(change - limit, rel=2e-2)


def test_a_contact_that_opens_forgets_its_tangential_force():
    law = LinearContact(stiffness=STIFFNESS, friction=0.5)
    moving = driven(law, [[0, 0], [0, 1e-3]]).advance(100, 1e-5)
    assert tangential(moving) < 0
    moving.velocity[:] = [[0, 0], [1e-1, 0]]
    moving.advance(150, 1e-5)  # 0.15 mm: open, still in the pair list
    assert len(moving.listed()) == 1
    assert tangential(moving) == 0.0
    assert force_on_second(moving) @ [1, 1] == 0.0


def test_grains_that_roll_like_gears_do_not_slip_and_those_that_spin_alike_do():
    law = LinearContact(stiffness=STIFFNESS, stiffness_ratio=1.0, friction=10.0)
    speed, steps, dt = 1e-3, 100, 1e-5
    assert tangential(driven(law, 0.0, [speed, -speed]).advance(steps, dt)) == 0.0
    spinning = driven(law, 0.0, [speed, speed]).advance(steps, dt)
    lever = 1 - OVERLAP / (2 * RADIUS)
    expected = STIFFNESS * 2 * speed * lever * steps * dt
    assert tangential(spinning) == pytest.approx(expected, rel=1e-9)
    moments = spinning.work.forces.grain[:, 2]
    np.testing.assert_allclose(moments, -lever * tangential(spinning), rtol=1e-9)  # brakes both


def test_the_moments_of_a_contact_balance_its_couple():
    """Net moment about any point is zero: angular momentum is conserved."""
    law = LinearContact(stiffness=STIFFNESS, friction=0.5)
    packing = two_grains(-OVERLAP, law, radii=(0.7 * RADIUS, RADIUS), angle=0.4)
    moving = Moving(packing, [[0, 0], [1e-3, 2e-3]], [1e-3, 3e-3], inverse_mass=DRIVEN)
    moving.advance(50, 1e-5)
    box, position = moving.packing.box, moving.work.motion.position
    grain = moving.work.forces.grain
    before = (position - 1e-5 * np.linalg.solve(box, moving.velocity.T)).T @ box.T
    arms = before[:, 0] * grain[:, 1] - before[:, 1] * grain[:, 0]
    total = arms.sum() + (packing.radii * grain[:, 2]).sum()
    assert abs(tangential(moving)) > 0
    assert abs(total) < 1e-9 * np.abs(packing.radii * grain[:, 2]).sum()


def test_cohesion_attracts_touching_grains_and_no_others():
    law = LinearContact(stiffness=STIFFNESS, friction=0.5, cohesion=3.0)
    for gap, expected in ((-1e-12, -3.0), (1e-12, 0.0), (-OVERLAP, PRESSED - 3.0)):
        moving = driven(law, gap=gap).advance(1, 1e-6)
        assert force_on_second(moving)[0] == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_friction_of_a_cohesive_contact_is_limited_by_its_elastic_part():
    law = LinearContact(stiffness=STIFFNESS, friction=0.3, cohesion=2 * PRESSED)
    moving = driven(law, [[0, -1e-3], [0, 1e-3]]).advance(3000, 1e-5)
    force = force_on_second(moving)
    assert force[0] < 0  # attraction wins
    overlap = 2 * RADIUS - np.linalg.norm(
        moving.packing.box @ (np.diff(moving.work.motion.position)[:, 0])
    )
    assert tangential(moving) == pytest.approx(-0.3 * STIFFNESS * overlap, rel=1e-2)


def test_a_dashpot_resists_the_normal_velocity_of_touching_grains():
    eta, speed = 0.2, 1e-2
    law = LinearContact(stiffness=STIFFNESS, friction=0.0, viscous_damping=eta)
    for sign in (1, -1):
        packing = two_grains(-OVERLAP, law)
        moving = Moving(packing, [[0, 0], [sign * speed, 0]]).advance(1, 1e-9)
        dashpot = 2 * eta * np.sqrt(STIFFNESS * packing.masses[0] / 2)  # reduced mass
        assert force_on_second(moving)[0] == pytest.approx(PRESSED - sign * dashpot * speed)
    apart = Moving(two_grains(OVERLAP, law), [[0, 0], [-speed, 0]]).advance(1, 1e-9)
    assert force_on_second(apart)[0] == 0.0
