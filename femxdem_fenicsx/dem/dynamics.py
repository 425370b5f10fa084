"""Time steps of one periodic packing of disks: the kernels that take nearly all of the run time.

A grain has a reduced position s (Desrues eq. 13), the velocity v that it has beyond the affine
motion of the box (eq. 14: v = h s'), and the rim speed w = R omega that it spins with beyond the
box's mean rotation. Accelerations are h s'' (eq. 15 for a quasi-static box). The box follows
h' = L h with a constant velocity gradient L, so that a rotation of the box is a rotation: for small
increments this is the straight path of eq. 3 to second order.

One step is a leapfrog step in three loops: forces of the pairs, their sum on each grain, motion.
"""

import math
from typing import NamedTuple

import numpy as np

from . import neighbours
from .aliasing import arrays_do_not_overlap, kernel

#: Most steps between two looks at how far the grains have moved.
LONGEST_BLIND_RUN = 16

OK, NO_ROOM = 0, 1


class Motion(NamedTuple):
    """What moves: box and grains."""

    box: np.ndarray  # (2, 2) columns are the box vectors, m
    position: np.ndarray  # (2, N) reduced, not wrapped
    velocity: np.ndarray  # (2, N) beyond the affine motion, m/s
    rim_speed: np.ndarray  # (N,) R omega beyond the box's rotation, m/s


class Forces(NamedTuple):
    """Forces of the last step."""

    pair: np.ndarray  # (2, P) on grain j of a pair, N
    pair_moment: np.ndarray  # (P,) slows the spin of both grains, as a force at the rim, N
    grain: np.ndarray  # (N, 4) net force (x, y), net moment / R, nothing, N


class Workspace(NamedTuple):
    """All arrays of one packing that is being computed; one per thread is enough."""

    motion: Motion
    forces: Forces
    pairs: neighbours.Pairs
    history: neighbours.History
    grid: neighbours.Grid


class Material(NamedTuple):
    """Constants of a packing as the kernels take them."""

    radius: np.ndarray  # (N,) m
    inverse_mass: np.ndarray  # (N,) 1/kg
    stiffness: float  # constant part of k_n, N/m
    modulus: float  # E_c, Pa
    stiffness_ratio: float  # k_t / k_n
    friction: float | None
    cohesion: float | None
    viscosity: float | None
    skin: float  # of the pair list, m


def workspace(grains: int, capacity: int, viscous: bool) -> Workspace:
    """Work space for a packing of that many grains and at most `capacity` pairs."""
    motion = Motion(
        np.zeros((2, 2)), np.zeros((2, grains)), np.zeros((2, grains)), np.zeros(grains)
    )
    forces = Forces(np.zeros((2, capacity)), np.zeros(capacity), np.zeros((grains, 4)))
    return Workspace(motion, forces, *neighbours.allocate(grains, capacity, viscous))


@kernel
def pair_forces(
    count, box, gradient, dt, position_x, position_y, velocity_x, velocity_y, rim_speed,
    first, second, shift_x, shift_y, reach, stiffness, dashpot, tangential,
    stiffness_ratio, friction, cohesion, viscosity, force_x, force_y, moment,
):  # fmt: skip
    """Forces of all pairs on their grain j, Desrues eq. 20-26 in two dimensions.

    The contact point divides the branch vector in the ratio of the radii, so that a rotation of
    the whole packing moves no contact; with eq. 21's full radii it would, by the overlap.
    """
    arrays_do_not_overlap()
    h00, h01, h10, h11 = box[0, 0], box[0, 1], box[1, 0], box[1, 1]
    l00, l01, l10, l11 = gradient[0, 0], gradient[0, 1], gradient[1, 0], gradient[1, 1]
    spin = 0.5 * (l10 - l01)
    for c in range(count):
        i, j = first[c], second[c]
        sx = position_x[j] - position_x[i] + shift_x[c]
        sy = position_y[j] - position_y[i] + shift_y[c]
        bx, by = h00 * sx + h01 * sy, h10 * sx + h11 * sy
        length = math.sqrt(bx * bx + by * by)
        nx, ny = bx / length, by / length
        elastic = max(stiffness[c] * (reach[c] - length), 0.0)
        normal = elastic
        if friction is not None or viscosity is not None:
            vx = velocity_x[j] - velocity_x[i] + l00 * bx + l01 * by
            vy = velocity_y[j] - velocity_y[i] + l10 * bx + l11 * by
        if viscosity is not None:
            normal -= dashpot[c] * (vx * nx + vy * ny) if elastic > 0.0 else 0.0
        if friction is not None:
            lever = length / reach[c]
            slip = vy * nx - vx * ny - lever * (rim_speed[i] + rim_speed[j] + spin * reach[c])
            limit = friction * max(normal, 0.0)
            trial = tangential[c] - stiffness_ratio * stiffness[c] * dt * slip
            tangent = min(max(trial, -limit), limit)
            tangential[c] = tangent
            moment[c] = lever * tangent
        if cohesion is not None:
            normal -= cohesion if elastic > 0.0 else 0.0
        if friction is not None:
            force_x[c] = normal * nx - tangent * ny
            force_y[c] = normal * ny + tangent * nx
        else:
            force_x[c], force_y[c] = normal * nx, normal * ny


@kernel
def sum_forces(row, second, force_x, force_y, moment, friction, grain):
    """Net force and moment of every grain."""
    arrays_do_not_overlap()
    for i in range(grain.shape[0]):
        grain[i, 0] = grain[i, 1] = grain[i, 2] = 0.0
    for i in range(grain.shape[0]):
        fx, fy, m = grain[i, 0], grain[i, 1], grain[i, 2]
        for c in range(row[i], row[i + 1]):
            j = second[c]
            grain[j, 0] += force_x[c]
            grain[j, 1] += force_y[c]
            fx -= force_x[c]
            fy -= force_y[c]
            if friction is not None:
                grain[j, 2] -= moment[c]
                m -= moment[c]
        grain[i, 0], grain[i, 1], grain[i, 2] = fx, fy, m


@kernel
def damped(force, velocity, impulse_to_velocity, damping):
    """Local non-viscous damping (Guo-Zhao eq. 18), by the sign of the velocity at mid-step."""
    sign = velocity + 0.5 * impulse_to_velocity * force
    return force - math.copysign(damping * force, sign)


@kernel
def move(
    box, dt, damping, inverse_mass, grain, friction,
    position_x, position_y, velocity_x, velocity_y, rim_speed,
):  # fmt: skip
    """Leapfrog: velocities from forces, reduced positions from velocities."""
    arrays_do_not_overlap()
    h00, h01, h10, h11 = box[0, 0], box[0, 1], box[1, 0], box[1, 1]
    scale = dt / (h00 * h11 - h01 * h10)
    for i in range(inverse_mass.size):
        impulse = dt * inverse_mass[i]
        vx, vy = velocity_x[i], velocity_y[i]
        vx += impulse * damped(grain[i, 0], vx, impulse, damping)
        vy += impulse * damped(grain[i, 1], vy, impulse, damping)
        velocity_x[i], velocity_y[i] = vx, vy
        position_x[i] += scale * (h11 * vx - h01 * vy)
        position_y[i] += scale * (h00 * vy - h10 * vx)
        if friction is not None:
            impulse *= 2.0  # a disk's inertia is m R^2 / 2
            rim_speed[i] += impulse * damped(grain[i, 2], rim_speed[i], impulse, damping)


@kernel
def start(material, work):
    """Build the pair list of the workspace's motion and give it the workspace's history."""
    count = neighbours.build(
        work.motion.box, work.motion.position, material.radius, material.inverse_mass,
        material.stiffness, material.modulus, material.viscosity, material.skin,
        work.pairs, work.grid,
    )  # fmt: skip
    if count < 0:
        return NO_ROOM
    neighbours.recall(work.pairs, work.history, work.grid)
    return OK


@kernel
def advance(steps, dt, gradient, damping, material, work):
    """Take that many steps of length dt while the box moves with velocity gradient L (2, 2), 1/s.

    Returns OK, or NO_ROOM where the pair list is too small for the motion.
    """
    motion, forces, pairs = work.motion, work.forces, work.pairs
    position, velocity = motion.position, motion.velocity
    growth = step_growth(gradient, dt)
    longest_reach = 2.0 * material.radius.max()
    look = 0
    for step in range(steps):
        if step >= look:
            used = neighbours.outdated(motion.box, position, longest_reach, material.skin, pairs)
            if used > 0.5:
                neighbours.remember(pairs, work.history)
                if start(material, work) != OK:
                    return NO_ROOM
                used = 0.0
            look = step + blind_run(
                velocity, gradient, longest_reach, dt, (1 - used) * material.skin
            )
        pair_forces(
            pairs.first[-1], motion.box, gradient, dt,
            position[0], position[1], velocity[0], velocity[1], motion.rim_speed,
            pairs.i, pairs.j, pairs.shift[0], pairs.shift[1], pairs.reach, pairs.stiffness,
            pairs.dashpot, pairs.tangential, material.stiffness_ratio, material.friction,
            material.cohesion, material.viscosity, forces.pair[0], forces.pair[1],
            forces.pair_moment,
        )  # fmt: skip
        sum_forces(
            pairs.first, pairs.j, forces.pair[0], forces.pair[1], forces.pair_moment,
            material.friction, forces.grain,
        )  # fmt: skip
        move(
            motion.box, dt, damping, material.inverse_mass, forces.grain, material.friction,
            position[0], position[1], velocity[0], velocity[1], motion.rim_speed,
        )  # fmt: skip
        deform_box(motion.box, growth)
    return OK


@kernel
def blind_run(velocity, gradient, reach, dt, slack):
    """Steps that may pass until grains can have moved by half of the slack (m) left in the skin."""
    fastest = 0.0
    for i in range(velocity.shape[1]):
        fastest = max(fastest, velocity[0, i] ** 2 + velocity[1, i] ** 2)
    strain_rate = (
        abs(gradient[0, 0]) + abs(gradient[0, 1]) + abs(gradient[1, 0]) + abs(gradient[1, 1])
    )
    speed = 2.0 * math.sqrt(fastest) + strain_rate * reach
    if speed * dt * LONGEST_BLIND_RUN * 2.0 < slack:
        return LONGEST_BLIND_RUN
    return max(int(0.5 * slack / (speed * dt)), 1)


@kernel
def step_growth(gradient, dt):
    """exp(L dt) - I for one step, (2, 2)."""
    g = gradient * dt
    total, term = g.copy(), g.copy()
    for k in range(2, 12):
        new = np.empty((2, 2))
        for a in range(2):
            for b in range(2):
                new[a, b] = (term[a, 0] * g[0, b] + term[a, 1] * g[1, b]) / k
        term = new
        total += term
    return total


@kernel
def deform_box(box, growth):
    """h <- (I + growth) h."""
    for b in range(2):
        x, y = box[0, b], box[1, b]
        box[0, b] = x + (growth[0, 0] * x + growth[0, 1] * y)
        box[1, b] = y + (growth[1, 0] * x + growth[1, 1] * y)


@kernel
def unbalance(work):
    """(largest net force on a grain, largest contact force) of the last step, N; eq. 19."""
    grain, pair = work.forces.grain, work.forces.pair
    net = 0.0
    for i in range(grain.shape[0]):
        net = max(net, grain[i, 0] ** 2 + grain[i, 1] ** 2)
    contact = 0.0
    for c in range(work.pairs.first[-1]):
        contact = max(contact, pair[0, c] ** 2 + pair[1, c] ** 2)
    return math.sqrt(net), math.sqrt(contact)
