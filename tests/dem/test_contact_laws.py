"""Every contact law on two grains, against its closed form; in two and in three dimensions."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.contacts import Bonds, HertzMindlin, LinearContact, RollingResistance
from femxdem_fenicsx.dem.homogenisation import elastic_energy, elastic_response, touching
from femxdem_fenicsx.dem.stability import stable_time_step

from .scenes import RADIUS, Moving, two_grains, two_spheres

OVERLAP, RADII = 1e-4, (0.8 * RADIUS, 1.2 * RADIUS)
COMMON_RADIUS = 2 * RADII[0] * RADII[1] / sum(RADII)  # r* of Guo-Zhao
ROLLING_RADIUS = COMMON_RADIUS / 2
G, NU, E_C, RATIO = 1e8, 0.3, 2e7, 0.7
COHESION, TENSION, SHEAR, ETA, ALPHA = 0.5, 3.0, 2.0, 0.2, 1.5

ELASTIC = {
    "linear": (LinearContact, {"modulus": E_C, "stiffness_ratio": RATIO}),
    "hertz": (HertzMindlin, {"shear_modulus": G, "poisson_ratio": NU}),
}
LAW_AND_DIM = [("linear", 2), ("linear", 3), ("hertz", 2), ("hertz", 3)]
RICH_LAW_AND_DIM = [("linear", 3), ("hertz", 2)]  # each takes half a minute to compile


def plain(law: str, dim: int):
    """Elasticity and so much friction that nothing slides."""
    kind, values = ELASTIC[law]
    nothing = {}
    if (law, dim) in RICH_LAW_AND_DIM:  # the kernels of `rich`, without its effects
        nothing = {"cohesion": 1e-30, "rolling": (0.0, 0.0), "bonds": (0.0, 0.0)}
    return kind(**values, friction=50.0, **nothing)


def rich(law: str):
    """Everything at once."""
    kind, values = ELASTIC[law]
    return kind(
        **values,
        friction=0.4,
        cohesion=COHESION,
        rolling=RollingResistance(ETA, ALPHA),
        bonds=Bonds(TENSION, SHEAR),
    )


def force(law: str, overlap: float) -> float:
    """Elastic normal force as the papers have it."""
    if law == "linear":
        return E_C * COMMON_RADIUS * overlap  # Guo-Zhao eq. 14, 16
    return 2 / 3 * G / (1 - NU) * np.sqrt(2 * COMMON_RADIUS) * overlap**1.5


def springs(law: str, overlap: float) -> tuple[float, float]:
    """(k_n, k_t): Guo-Zhao eq. 14-15 and section 2.2."""
    if law == "linear":
        return E_C * COMMON_RADIUS, RATIO * E_C * COMMON_RADIUS
    root = np.sqrt(2 * COMMON_RADIUS * overlap)
    return G / (1 - NU) * root, 2 * G / (2 - NU) * root


class Pair:
    """Two grains whose velocities and spins no force can change."""

    def __init__(self, law, dim: int, overlap: float = OVERLAP, bonded: bool = False):
        self.dim = dim
        scene = two_grains if dim == 2 else two_spheres
        packing = scene(-overlap, law, radii=RADII)
        if bonded:
            held = np.zeros(1) if dim == 2 else np.zeros((1, 3))
            packing = packing.but(contacts=[[0, 1]], tangential=held, bonded=[1.0])
        self.moving = Moving(packing, inverse_mass=np.full(2, 1e-30))
        self.overlap = overlap

    def move(self, closer=0.0, across=0.0, rolled=0.0, steps=2000) -> "Pair":
        """Bring them so much closer and across (m); roll the second (rad) on the first."""
        dt = 1.0 / steps
        velocity = np.zeros((2, self.dim))
        velocity[1, :2] = -closer, across
        self.moving.work.motion.velocity[:] = velocity.T
        rim = np.zeros((2, 1 if self.dim == 2 else 3))
        turns = np.array([-RADII[1], RADII[0]]) / sum(RADII)  # like gears: without any slip
        rim[:, -1] = np.array(RADII) * turns * rolled
        self.moving.work.motion.rim_velocity[:] = rim.T
        self.moving.advance(steps, dt)
        self.overlap += closer
        return self

    @property
    def normal(self) -> float:
        """On the second grain in the last step, compression positive, N."""
        return float(self.moving.work.forces.pair[0, 0])

    @property
    def tangential(self) -> float:
        """Against the motion across, hence positive."""
        return -float(self.moving.work.pairs.tangential[0 if self.dim == 2 else 1, 0])

    @property
    def moment(self) -> float:
        """Of the rolling resistance, against the rolling."""
        return -float(self.moving.work.pairs.memory[0 if self.dim == 2 else 2, 0])

    @property
    def bonded(self) -> bool:
        return bool(self.moving.work.pairs.memory[-1, 0])


# Elasticity


@pytest.mark.parametrize(("law", "dim"), LAW_AND_DIM)
def test_the_normal_force_follows_its_closed_form_there_and_back(law, dim):
    pair = Pair(plain(law, dim), dim)
    for closer in (OVERLAP, -1.5 * OVERLAP):
        pair.move(closer=closer)
        assert pair.normal == pytest.approx(force(law, pair.overlap), rel=3e-3)
    assert pair.move(closer=-OVERLAP).normal == 0.0


@pytest.mark.parametrize(("law", "dim"), LAW_AND_DIM)
def test_stiffnesses_are_the_derivatives_of_the_forces(law, dim):
    """df_n / du_n and df_t / du_t of the kernels' forces, by finite differences."""
    small = 1e-4 * OVERLAP
    below, above = (
        Pair(plain(law, dim), dim, OVERLAP + change).move(steps=20).normal
        for change in (-small, small)
    )
    sheared = Pair(plain(law, dim), dim).move(across=small)
    contacts = touching(sheared.moving.packing)
    k_n, k_t = springs(law, OVERLAP)
    assert contacts.stiffness[0] == pytest.approx(k_n, rel=1e-9)
    assert contacts.tangential_stiffness[0] == pytest.approx(k_t, rel=1e-9)
    assert (above - below) / (2 * small) == pytest.approx(k_n, rel=1e-6)
    assert sheared.tangential / small == pytest.approx(k_t, rel=1e-6)


@pytest.mark.parametrize(("law", "dim"), LAW_AND_DIM)
def test_the_energy_of_a_contact_is_the_work_of_its_closed_form(law, dim):
    pair = Pair(plain(law, dim), dim).move(across=1e-6)
    pressed = force(law, OVERLAP) * OVERLAP * (1 / 2 if law == "linear" else 2 / 5)
    _, k_t = springs(law, OVERLAP)
    assert elastic_energy(pair.moving.now) == pytest.approx(pressed + k_t * 1e-12 / 2, rel=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_tangential_force_of_hertz_mindlin_falls_with_k_t_and_does_not_grow_with_it(dim):
    s, release = 1e-6, -0.75 * OVERLAP  # k_t falls to a half
    _, stiff = springs("hertz", OVERLAP)
    pair, tilt = (
        Pair(plain("hertz", dim), dim).move(across=s),
        5e-3,
    )  # s / 2R lets it slip by release
    assert pair.tangential == pytest.approx(stiff * s, rel=2e-3)
    assert pair.move(closer=release).tangential == pytest.approx(stiff / 2 * s, rel=tilt)
    assert pair.move(closer=-release).tangential == pytest.approx(stiff / 2 * s, rel=tilt)
    assert pair.move(across=-s).tangential == pytest.approx(-stiff / 2 * s, rel=2 * tilt)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("sheared_first", [True, False])
def test_no_cycle_of_shear_and_pressure_gains_energy_from_a_hertz_mindlin_contact(
    dim, sheared_first
):
    """It takes k_t s^2 / 4, where k_t falls to a half and grows again.

    With f_t kept in unloading (k_t du_t alone) the cycle that is sheared first would give as much.
    """
    s, release = 1e-6, -0.75 * OVERLAP
    _, stiff = springs("hertz", OVERLAP)
    pair = Pair(plain("hertz", dim), dim)
    stages = [{"closer": release}, {"across": s}, {"closer": -release}, {"across": -s}]
    if sheared_first:
        stages = [{"across": s}, {"closer": release}, {"across": -s}, {"closer": -release}]
    work = 0.0
    for stage in stages:
        for _ in range(20):
            before = pair.tangential
            pair.move(**{name: value / 20 for name, value in stage.items()}, steps=200)
            work += 0.5 * (before + pair.tangential) * stage.get("across", 0.0) / 20
    assert work == pytest.approx(0.25 * stiff * s**2, rel=0.02)


@pytest.mark.parametrize("law", ELASTIC)
def test_forces_of_a_law_are_its_methods_called_from_python_too(law):
    elasticity = plain(law, 2).elasticity
    coefficient = elasticity.coefficient(*RADII)
    compiled = elastic_response(elasticity, np.array([coefficient]), np.array([OVERLAP]))
    np.testing.assert_allclose(compiled[0], elasticity.normal_force(coefficient, OVERLAP))
    np.testing.assert_allclose(
        np.ravel(compiled[1:]), elasticity.stiffnesses(coefficient, OVERLAP), rtol=1e-14
    )


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"shear_modulus": 0.0}, "HertzMindlin: shear_modulus must be positive"),
        ({"shear_modulus": float("nan")}, "shear_modulus"),
        ({"shear_modulus": 1e9, "poisson_ratio": 0.6}, "poisson_ratio"),
        ({"shear_modulus": 1e9, "friction": -1.0}, "HertzMindlin: friction"),
        ({"shear_modulus": 1e9, "bonds": Bonds(-1.0, 1.0)}, r"bonds\.tension"),
        ({"shear_modulus": 1e9, "bonds": Bonds(1.0, float("inf"))}, r"bonds\.shear"),
        ({"shear_modulus": 1e9, "rolling": RollingResistance(-0.1)}, r"rolling\.friction"),
        ({"shear_modulus": 1e9, "rolling": RollingResistance(0.1), "friction": 0}, "need friction"),
        ({"shear_modulus": 1e9, "bonds": Bonds(1.0, 1.0), "friction": 0}, "need friction"),
    ],
)
def test_parameters_that_make_no_contact_are_refused_by_name(values, complaint):
    with pytest.raises(ValueError, match=complaint):
        HertzMindlin(**values)


# Cohesion and bonds


@pytest.mark.parametrize(("law", "dim"), RICH_LAW_AND_DIM)
def test_cohesion_attracts_those_that_touch_whatever_the_elastic_law(law, dim):
    pair = Pair(rich(law), dim).move(steps=20)
    assert pair.normal == pytest.approx(force(law, OVERLAP) - COHESION, rel=1e-6)
    assert Pair(rich(law), dim, -1e-9).move(steps=20).normal == 0.0


def stretch_at_break(law: str) -> float:
    low, high = 0.0, 10 * OVERLAP
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if force(law, middle) < TENSION else (low, middle)
    return high


@pytest.mark.parametrize(("law", "dim"), RICH_LAW_AND_DIM)
def test_a_bond_pulls_up_to_its_strength_and_is_broken_for_good(law, dim):
    pair, most = Pair(rich(law), dim, bonded=True), stretch_at_break(law)
    pair.move(closer=-OVERLAP - 0.5 * most)
    assert pair.normal == pytest.approx(-force(law, 0.5 * most), rel=1e-2)
    pair.move(closer=-0.49 * most)
    assert pair.normal == pytest.approx(-TENSION, rel=3e-2)
    assert pair.bonded
    assert pair.move(closer=-0.02 * most).normal == 0.0
    assert not pair.bonded
    pair.move(closer=0.5 * most)
    assert pair.normal == pair.tangential == 0.0
    pair.move(closer=OVERLAP - pair.overlap)
    assert pair.normal == pytest.approx(force(law, OVERLAP) - COHESION, rel=1e-2)
    assert pair.move(closer=-1.2 * OVERLAP).normal == 0.0


@pytest.mark.parametrize(("law", "dim"), RICH_LAW_AND_DIM)
def test_a_bond_bears_its_shear_strength_beside_friction_and_friction_is_left(law, dim):
    pair = Pair(rich(law), dim, bonded=True)
    slides_at = 0.4 * force(law, OVERLAP)
    breaks_at = (slides_at + SHEAR) / springs(law, OVERLAP)[1]
    assert pair.move(across=0.99 * breaks_at).tangential == pytest.approx(
        0.99 * (slides_at + SHEAR), rel=2e-3
    )
    assert pair.bonded
    assert pair.move(across=0.02 * breaks_at).tangential == pytest.approx(slides_at, rel=2e-3)
    assert not pair.bonded


# Rolling resistance


@pytest.mark.parametrize(("law", "dim"), RICH_LAW_AND_DIM)
def test_a_rolled_contact_is_a_spring_up_to_a_limit_and_springs_back(law, dim):
    pair = Pair(rich(law), dim)
    k_r = ALPHA * springs(law, OVERLAP)[1] * ROLLING_RADIUS**2
    limit = ETA * ROLLING_RADIUS * force(law, OVERLAP)
    yields_at = limit / k_r
    assert pair.move(rolled=0.5 * yields_at).moment == pytest.approx(limit / 2, rel=2e-3)
    energy = elastic_energy(pair.moving.now)
    unrolled = elastic_energy(Pair(rich(law), dim).moving.packing)
    assert energy - unrolled == pytest.approx(0.5 * (limit / 2) ** 2 / k_r, rel=1e-2)
    assert pair.move(rolled=1.5 * yields_at).moment == pytest.approx(limit, rel=1e-9)
    assert pair.move(rolled=-0.5 * yields_at).moment == pytest.approx(limit / 2, rel=5e-3)
    assert pair.move(rolled=-3.0 * yields_at).moment == pytest.approx(-limit, rel=1e-9)
    assert abs(pair.tangential) < 1e-6 * force(law, OVERLAP)  # it rolled without slip


@pytest.mark.parametrize(("law", "dim"), RICH_LAW_AND_DIM)
def test_moments_on_the_two_grains_of_a_rolled_contact_balance(law, dim):
    pair = Pair(rich(law), dim).move(rolled=1e-5, steps=200)
    moments = pair.moving.work.forces.grain[:, 2 if dim == 2 else 6] * RADII
    assert abs(pair.moment) > 0
    np.testing.assert_allclose(moments, [pair.moment, -pair.moment], rtol=1e-9)


@pytest.mark.parametrize(("law", "dim"), RICH_LAW_AND_DIM)
def test_rolling_resistance_stops_grains_that_roll_after_the_angle_of_its_closed_form(law, dim):
    """Two equal grains held by cohesion at f_n = f_c turn like gears: I dw/dt = - eta r f_n."""
    kind, values = ELASTIC[law]
    law = kind(**values, cohesion=5.0, rolling=RollingResistance(0.05, 50.0), bonds=Bonds(1.0, 1.0))
    scene = two_grains if dim == 2 else two_spheres
    packing = scene(-two_grains(0.0, law).overlap_under(5.0 / (2 * RADIUS * 0.1)), law)
    contacts = touching(packing)
    assert contacts.normal_force[0] == pytest.approx(0.0, abs=1e-6)
    inertia = packing.masses[0] * RADIUS**2 * (0.5 if dim == 2 else 0.4)
    spin, braking = 5.0, 0.05 * RADIUS / 2 * 5.0
    rim = np.zeros((2, 1 if dim == 2 else 3))
    rim[:, -1] = RADIUS * spin, -RADIUS * spin
    stop = inertia * spin / braking
    dt = min(0.05 * stable_time_step(packing), stop / 1000)
    moving = Moving(packing, rim_speed=rim if dim == 3 else rim[:, 0])
    angle, history = 0.0, []
    for _ in range(int(2 * stop / dt / 10)):
        moving.advance(10, dt)
        history.append(moving.work.motion.rim_velocity[-1, 0] / RADIUS)
        angle += history[-1] * 10 * dt
    halfway = history[int(0.5 * stop / dt / 10) - 1]
    assert halfway == pytest.approx(0.5 * spin, rel=3e-2)
    assert angle == pytest.approx(inertia * spin**2 / (2 * braking), rel=3e-2)
    k_r = 50.0 * contacts.tangential_stiffness[0] * (RADIUS / 2) ** 2
    quiver = braking / np.sqrt(2 * inertia * k_r)  # of its spring, when it has stopped
    assert np.abs(history[-len(history) // 4 :]).max() == pytest.approx(quiver, rel=2e-2)
    assert quiver < 0.04 * spin
    assert np.abs(moving.work.pairs.tangential).max() < 1e-6 * 5.0


def test_the_stable_time_step_knows_the_spring_of_rolling():
    """Two disks against each other: I theta'' = - k_r theta each, omega^2 = 2 k_r / I."""
    law = LinearContact(
        stiffness=1e5, stiffness_ratio=0.5, friction=0.5, rolling=RollingResistance(0.1, 100.0)
    )
    packing = two_grains(-1e-5, law)
    k_r = 100.0 * 0.5e5 * (RADIUS / 2) ** 2
    omega = np.sqrt(2 * k_r / (packing.masses[0] * RADIUS**2 / 2))
    assert stable_time_step(packing) == pytest.approx(2 / omega, rel=1e-3)
