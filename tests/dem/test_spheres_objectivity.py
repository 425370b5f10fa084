"""The tangential law of spheres is objective: what a turning observer sees is turned, no more.

A step of eq. 24 and of eq. 10 turns the tangential force exactly but for terms of second order in
the angle of a step (eq. 24: 1 - cos). Over a total angle A in n steps that leaves an error of order
A^2 / n. An observer who turns ever faster adds A / n, because a step takes the spins of its end; so
does eq. 12, which turns this step's slip once too often. The tests below count on that, and
measure it.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from femxdem_fenicsx.dem import spheres
from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.contacts import SCHEMES, LinearContact
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from tests.reference import reference_spheres

from .scenes import STIFFNESS, turn

RADII = np.array([7e-3, 1e-2])
OVERLAP = 1e-3 * RADII.sum()


class Path:
    """A random smooth motion of two touching grains over a time of 1 s, exact at any time."""

    def __init__(self, seed: int, extent: float):
        """`extent`: how far the grains move and turn, rad and sums of radii."""
        rng = np.random.default_rng(seed)
        direction = rng.normal(size=3)
        self.branch = (RADII.sum() - OVERLAP) * direction / np.linalg.norm(direction)
        self.centre = 0.05 * rng.normal(size=3)
        self.sway = extent * 0.3 * OVERLAP * rng.normal(size=(2, 2, 3))
        self.axis = rng.normal(size=3)
        self.angle, self.drift = extent * rng.uniform(0.3, 1.0), extent * rng.normal(size=3)
        self.spins = extent * rng.normal(size=(2, 2, 3))
        across = np.cross(self.branch, rng.normal(size=3))
        self.held = 0.3 * 0.2 * STIFFNESS * OVERLAP * across / np.linalg.norm(across)

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and spins (2, 3)."""
        spin = self.angle * self.axis / np.linalg.norm(self.axis)  # one grain goes round the other
        branch = turn(self.axis, self.angle * time) @ self.branch
        position = np.array([self.centre, self.centre + branch]) + 1e-2 * self.drift * time
        velocity = np.array([np.zeros(3), skew(spin) @ branch]) + 1e-2 * self.drift
        position += self.sway[0] * np.sin(3 * time) + self.sway[1] * (np.cos(2 * time) - 1)
        velocity += 3 * self.sway[0] * np.cos(3 * time) - 2 * self.sway[1] * np.sin(2 * time)
        return position, velocity, self.spins[0] + self.spins[1] * np.sin(4 * time) + spin


class Frame:
    """An observer who turns, x = R x': steadily, or ever faster about an axis that turns itself."""

    def __init__(self, seed: int, angle: float, steady: bool = False):
        rng = np.random.default_rng(seed)
        self.first, self.second = rng.normal(size=(2, 3))
        self.first /= np.linalg.norm(self.first)
        self.second /= np.linalg.norm(self.second)
        self.angle, self.steady = angle, steady

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """R (3, 3) and its rate of rotation (3,)."""
        if self.angle == 0.0:
            return np.eye(3), np.zeros(3)
        if self.steady:
            return turn(self.first, self.angle * time), self.angle * self.first
        a, b = self.angle * (time + 0.2 * np.sin(2 * time)), 0.7 * self.angle * time
        outer = turn(self.first, a)
        rate = self.angle * (1 + 0.4 * np.cos(2 * time)) * self.first
        return outer @ turn(self.second, b), rate + 0.7 * self.angle * outer @ self.second


def skew(vector) -> np.ndarray:
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def force_at_the_end(path: Path, frame: Frame, steps: int, law: LinearContact, by_box=False):
    """Total and tangential force on the second grain that the observer sees after 1 s.

    The observer's turning is in the grains' velocities and spins, or in the motion of the box.
    """
    friction, cohesion, viscosity = law.features
    projected, implicit = law.turning
    pair = {"coefficient": STIFFNESS, "reach": RADII.sum(), "dashpot": 2.0}
    pair = {name: np.full(1, value) for name, value in pair.items()}
    first, second = np.array([0], np.uint32), np.array([1], np.uint32)
    shift, force, moment = np.zeros((3, 1)), np.zeros((3, 1)), np.zeros((3, 1))
    memory = np.zeros((0, 1))
    R, _ = frame.at(0.0)
    branch = np.diff(path.at(0.0)[0], axis=0)[0]
    normal = (R @ branch / np.linalg.norm(branch))[:, None]
    tangent = (R @ path.held)[:, None]
    for k in range(1, steps + 1):
        position, velocity, spin = path.at(k / steps)
        R, rate = frame.at(k / steps)
        box, gradient, velocity = np.eye(3), np.zeros((3, 3)), velocity @ R.T
        if by_box:
            box, gradient = R, skew(rate)
            position, spin = position.copy(), spin @ R.T
        else:
            position, spin = position @ R.T, spin @ R.T + rate
            velocity = velocity + position @ skew(rate).T
        spheres.pair_forces(
            1, np.ascontiguousarray(box), gradient, 1.0 / steps, *np.ascontiguousarray(position.T),
            *np.ascontiguousarray(velocity.T), *np.ascontiguousarray((RADII[:, None] * spin).T),
            1.0 / RADII, first, second, *shift, pair["reach"], pair["coefficient"],
            pair["dashpot"] if viscosity else None, *tangent, memory, *normal, law.elasticity,
            friction, cohesion, viscosity, law.rolling, law.bonds, projected, implicit, *force,
            *moment,
        )  # fmt: skip
    return R.T @ force[:, 0], R.T @ tangent[:, 0]


def law_of(scheme: str, friction: float = 0.2) -> LinearContact:
    return LinearContact(stiffness=STIFFNESS, friction=friction, scheme=scheme)


STILL = Frame(0, 0.0)


@pytest.mark.parametrize("by_box", [False, True], ids=["grains turn", "box turns"])
@pytest.mark.parametrize("scheme", SCHEMES)
@settings(max_examples=8, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    friction=st.sampled_from([0.05, 0.2, 1.0]),
    steady=st.booleans(),
)
def test_a_turning_observer_sees_the_turned_force_to_1e_10(scheme, by_box, seed, friction, steady):
    path, law, steps = Path(seed, 1e-4), law_of(scheme, friction), 250
    here, tangential = force_at_the_end(path, STILL, steps, law)
    angle = 5e-8 if scheme == "implicit" else 1e-5 if steady else 5e-7  # see above
    there, _ = force_at_the_end(path, Frame(seed, angle, steady), steps, law, by_box)
    assert np.linalg.norm(tangential) > 1e-3 * np.linalg.norm(here)
    assert np.linalg.norm(there - here) < 1e-10 * np.linalg.norm(here)


@pytest.mark.parametrize("turning", [(1e-5, True), (5e-7, False), (5e-8, True)])
def test_a_law_without_spins_would_fail_that_test(turning):
    """The small angle is no excuse: what the observer's rotation does is above 1e-10."""
    path, frame, law = Path(3, 1e-4), Frame(3, *turning), law_of("semi-explicit")
    here, _ = force_at_the_end(path, STILL, 250, law)
    moves = frame.at
    frame.at = lambda time: (moves(time)[0], np.zeros(3))  # turned, but not turning
    there, _ = force_at_the_end(path, frame, 250, law)
    assert np.linalg.norm(there - here) > 1e-9 * np.linalg.norm(here)


@pytest.mark.parametrize("by_box", [False, True], ids=["grains turn", "box turns"])
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(("seed", "friction"), [(0, 1.0), (1, 1.0), (2, 0.05)])
def test_what_a_fast_observer_sees_converges_to_the_turned_force(scheme, by_box, seed, friction):
    """First order in the step; extrapolated to no step at all, the error is of second order."""
    path, frame = Path(seed, 1e-2), Frame(seed, 1.0)
    law = law_of(scheme, friction)
    seen, errors = [], []
    for steps in (250, 500, 1000):
        here, tangential = force_at_the_end(path, STILL, steps, law)
        there, _ = force_at_the_end(path, frame, steps, law, by_box)
        seen.append(there - here)
        errors.append(np.linalg.norm(there - here) / np.linalg.norm(tangential))
    assert errors[0] < 1e-2
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(2, rel=0.05)
    limits = [2 * seen[1] - seen[0], 2 * seen[2] - seen[1]]
    assert np.linalg.norm(limits[0]) < 1e-2 * np.linalg.norm(seen[0])
    assert np.linalg.norm(limits[1]) < 0.3 * np.linalg.norm(limits[0])


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_schemes_converge_to_one_law(scheme):
    """First order, to the same force, along a path on which the contact turns and slides."""
    path, ends = Path(5, 0.3), {}
    for name in ("semi-explicit", scheme):
        for steps in (500, 1000):
            ends[name, steps] = force_at_the_end(path, STILL, steps, law_of(name, 0.1))[1]
    limits = {n: 2 * ends[n, 1000] - ends[n, 500] for n in ("semi-explicit", scheme)}
    size = np.linalg.norm(limits["semi-explicit"])
    assert size > 0
    assert np.linalg.norm(ends[scheme, 1000] - ends[scheme, 500]) < 4e-3 * size
    assert np.linalg.norm(limits[scheme] - limits["semi-explicit"]) < 1e-4 * size


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_sphere_that_rolls_on_another_in_an_arc_feels_no_tangential_force(scheme):
    axis = np.array([0.3, 0.8, -0.5]) / np.linalg.norm([0.3, 0.8, -0.5])
    path = Path(1, 0.0)
    path.branch -= path.branch @ axis * axis
    path.branch *= (RADII.sum() - OVERLAP) / np.linalg.norm(path.branch)
    path.axis, path.angle, path.held = axis, 0.5, np.zeros(3)
    orbit, still = path.at, np.zeros(3)

    def rolling(time):
        position, velocity, _ = orbit(time)
        spin = path.angle * RADII.sum() / RADII[1] * axis  # like a planet wheel on its sun
        return position, velocity, np.array([still, spin])

    path.at = rolling
    force, tangential = force_at_the_end(path, STILL, 500, law_of(scheme))
    assert np.linalg.norm(tangential) < 1e-10 * STIFFNESS * OVERLAP
    along = np.diff(rolling(1.0)[0], axis=0)[0] / (RADII.sum() - OVERLAP)
    np.testing.assert_allclose(force, STIFFNESS * OVERLAP * along, rtol=1e-6, atol=1e-6)


# A whole packing


@pytest.fixture(scope="module")
def sheared():
    """YADE's spheres after 0.2 % of shear, with tangential forces in most contacts."""
    law = HomogenisedLaw(reference_spheres(), 1, PRESETS["balanced"])
    step = np.eye(3) + 1e-3 * np.array([[0.5, 1.0, 0.0], [0.3, -1.0, 0.4], [0.0, 0.0, 0.3]])
    for _ in range(2):
        law.evaluate(step[None])
        law.commit()
    law.evaluate(np.eye(3)[None])  # at rest, so that a rotation alone is what follows
    law.commit()
    return law.packing(0), law.stress[0].copy()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_packing_turned_by_10_degrees_at_once_has_the_turned_stress(sheared, scheme):
    packing, stress = sheared
    packing = packing.but(law=LinearContact(modulus=6e8, scheme=scheme))
    R = turn([1.0, -2.0, 0.7], np.radians(10.0))
    # what is not at rest to that tolerance yet is brought there by both
    law = HomogenisedLaw(packing, 1, PRESETS["balanced"].but(tolerance=1e-4, hold_limit=20000))
    start = law.evaluate(np.eye(3)[None])[0]
    turned = law.evaluate(R[None])[0]
    assert np.abs(turned - start).max() > 2e-2 * np.abs(start).max()
    expected = R @ start @ R.T
    assert np.linalg.norm(turned - expected) < 1e-3 * np.linalg.norm(stress)


def test_a_packing_turned_by_360_degrees_in_36_steps_comes_back_to_its_stress(sheared):
    packing, stress = sheared
    assert np.abs(packing.tangential).max() > 0.1
    law = HomogenisedLaw(packing, 1, PRESETS["balanced"])
    R = turn([1.0, -2.0, 0.7], np.radians(10.0))
    for _ in range(36):
        law.evaluate(R[None])
        law.commit()
    np.testing.assert_allclose(law.deformation[0], np.eye(3), atol=1e-6)
    assert np.linalg.norm(law.stress[0] - stress) < 1e-2 * np.linalg.norm(stress)
