"""Time steps of one periodic packing, disks or spheres: what takes nearly all of the run time.

A grain has a reduced position s (Desrues eq. 13), the velocity v that it has beyond the affine
motion of the box (eq. 14: v = h s'), and the rim velocity w = R omega that it spins with beyond the
box's mean rotation. It moves by dv/dt = d(h s')/dt = f / m: eq. 15 without terms of the box's own
motion, which change the stress by 0.015 % (docs/method.md). The box follows h' = L h with a
constant velocity gradient L, so that a rotation of the box is a rotation: for small increments this
is the straight path of eq. 3 to second order.

One step is a leapfrog step in three loops: forces of the pairs, their sum on each grain, motion.
"""

import math
from typing import NamedTuple

import numpy as np

from . import disks, neighbours, spheres
from .aliasing import kernel, part_of_kernels
from .small import product

#: Most steps between two looks at how far the grains have moved.
LONGEST_BLIND_RUN = 16

OK, NO_ROOM, TOO_MANY_CONTACTS = 0, 1, 2


class Motion(NamedTuple):
    """What moves: box and grains. In 2D a spin has one component (q = 1), in 3D three."""

    box: np.ndarray  # (d, d) columns are the box vectors, m
    position: np.ndarray  # (d, N) reduced, not wrapped
    velocity: np.ndarray  # (d, N) beyond the affine motion, m/s
    rim_velocity: np.ndarray  # (q, N) R omega beyond the box's rotation, m/s


class Forces(NamedTuple):
    """Forces of the last step."""

    pair: np.ndarray  # (d, P) on grain j of a pair, N
    pair_moment: np.ndarray  # (q, P) slows the spin of both grains, as a force at the rim, N
    grain: np.ndarray  # (N, 4 or 8) net force, net moment / R behind it, N


class Workspace(NamedTuple):
    """All arrays of one packing that is being computed; one per thread is enough."""

    motion: Motion
    forces: Forces
    pairs: neighbours.Pairs
    history: neighbours.History
    grid: neighbours.Grid


class Material(NamedTuple):
    """Constants of a packing as the kernels take them; None for what the scene does not have."""

    radius: np.ndarray  # (N,) m
    inverse_mass: np.ndarray  # (N,) 1/kg
    inverse_radius: np.ndarray | None  # (N,) 1/m, of spheres; None says that grains are disks
    law: tuple  # the elastic law, with its methods (`contacts.interface`)
    friction: float | None
    cohesion: float | None
    viscosity: float | None
    rolling: tuple | None
    bonds: tuple | None
    projected: bool | None  # tangential force by Desrues eq. 10
    implicit: bool | None  # tangential force by Desrues eq. 12
    skin: float  # of the pair list, m


def workspace(grains: int, dim: int, capacity: int, viscous: bool, memory: int = 0) -> Workspace:
    """Work space for a packing of that many grains and at most `capacity` pairs.

    `memory`: how many values a contact remembers beside its tangential force.
    """
    spins = 1 if dim == 2 else 3
    motion = Motion(
        np.zeros((dim, dim)),
        np.zeros((dim, grains)),
        np.zeros((dim, grains)),
        np.zeros((spins, grains)),
    )
    forces = Forces(
        np.zeros((dim, capacity)),
        np.zeros((spins, capacity)),
        np.zeros((grains, 4 if dim == 2 else 8)),
    )
    return Workspace(motion, forces, *neighbours.allocate(grains, dim, capacity, viscous, memory))


@kernel
def start(work, radius, inverse_mass, law, viscosity, skin):
    """Build the pair list of the workspace's motion and give it the workspace's history.

    Of a `Material` these are all that it takes: so it is compiled once for any friction.
    """
    count = neighbours.build(
        work.motion.box, work.motion.position, radius, inverse_mass, law, viscosity, skin,
        work.pairs, work.grid,
    )  # fmt: skip
    if count < 0:
        return NO_ROOM
    neighbours.recall(work.pairs, work.history, work.grid)
    return OK


@kernel
def advance(steps, dt, gradient, damping, material, work, inverse_radius):
    """Take that many steps of length dt while the box moves with velocity gradient L (d, d), 1/s.

    `inverse_radius` is the material's: compiled for disks where it is None, otherwise for spheres.
    Returns OK, or NO_ROOM where the pair list is too small for the motion.
    """
    motion, forces, pairs = work.motion, work.forces, work.pairs
    box, x, v, w = motion.box, motion.position, motion.velocity, motion.rim_velocity
    growth = step_growth(gradient, dt)
    longest_reach = 2.0 * material.radius.max()
    look = 0
    for step in range(steps):
        if step >= look:
            used = neighbours.outdated(box, x, longest_reach, material.skin, pairs)
            if used > 0.5:
                neighbours.remember(pairs, work.history)
                status = start(
                    work, material.radius, material.inverse_mass, material.law,
                    material.viscosity, material.skin,
                )  # fmt: skip
                if status != OK:
                    return NO_ROOM
                used = 0.0
            slack = (1.0 - used) * material.skin
            look = step + blind_run(v, gradient, longest_reach, dt, slack)
        if inverse_radius is None:
            disks.pair_forces(
                pairs.first[-1], box, gradient, dt, x[0], x[1], v[0], v[1], w[0],
                material.radius, pairs.i, pairs.j, pairs.shift[0], pairs.shift[1], pairs.reach,
                pairs.coefficient, pairs.dashpot, pairs.tangential[0], pairs.memory,
                material.law, material.friction, material.cohesion, material.viscosity,
                material.rolling, material.bonds,
                forces.pair[0], forces.pair[1], forces.pair_moment[0],
            )  # fmt: skip
            disks.sum_forces(
                pairs.first, pairs.j, forces.pair[0], forces.pair[1], forces.pair_moment[0],
                pairs.memory, material.radius, material.friction, material.rolling, forces.grain,
            )  # fmt: skip
            disks.move(
                box, dt, damping, material.inverse_mass, forces.grain, material.friction,
                x[0], x[1], v[0], v[1], w[0],
            )  # fmt: skip
        else:
            spheres.pair_forces(
                pairs.first[-1], box, gradient, dt,
                x[0], x[1], x[2], v[0], v[1], v[2], w[0], w[1], w[2], inverse_radius,
                pairs.i, pairs.j, pairs.shift[0], pairs.shift[1], pairs.shift[2],
                pairs.reach, pairs.coefficient, pairs.dashpot,
                pairs.tangential[0], pairs.tangential[1], pairs.tangential[2], pairs.memory,
                pairs.normal[0], pairs.normal[1], pairs.normal[2], material.law,
                material.friction, material.cohesion, material.viscosity, material.rolling,
                material.bonds, material.projected, material.implicit,
                forces.pair[0], forces.pair[1], forces.pair[2],
                forces.pair_moment[0], forces.pair_moment[1], forces.pair_moment[2],
            )  # fmt: skip
            spheres.sum_forces(
                pairs.first, pairs.j, forces.pair[0], forces.pair[1], forces.pair[2],
                forces.pair_moment[0], forces.pair_moment[1], forces.pair_moment[2],
                pairs.memory, inverse_radius, material.friction, material.rolling, forces.grain,
            )  # fmt: skip
            spheres.move(
                box, dt, damping, material.inverse_mass, forces.grain, material.friction,
                x[0], x[1], x[2], v[0], v[1], v[2], w[0], w[1], w[2],
            )  # fmt: skip
        deform_box(box, growth)
    return OK


@part_of_kernels
def blind_run(velocity, gradient, reach, dt, slack):
    """Steps that may pass until grains can have moved by half of the slack (m) left in the skin."""
    fastest = 0.0
    for i in range(velocity.shape[1]):
        squared = 0.0
        for a in range(velocity.shape[0]):
            squared += velocity[a, i] ** 2
        fastest = max(fastest, squared)
    speed = 2.0 * math.sqrt(fastest) + np.abs(gradient).sum() * reach
    if speed * dt * LONGEST_BLIND_RUN * 2.0 < slack:
        return LONGEST_BLIND_RUN
    return max(int(0.5 * slack / (speed * dt)), 1)


@kernel
def step_growth(gradient, dt):
    """exp(L dt) - I for one step, (d, d)."""
    dim = gradient.shape[0]
    total, term = np.zeros((dim, dim)), np.eye(dim)
    for k in range(1, 12):
        term = product(term, gradient)
        for a in range(dim):
            for b in range(dim):
                term[a, b] *= dt / k
                total[a, b] += term[a, b]
    return total


@part_of_kernels
def deform_box(box, growth):
    """h <- h + growth h, without a temporary array: this is called every step."""
    for b in range(box.shape[1]):
        x, y, z = box[0, b], box[1, b], 0.0
        if box.shape[0] == 3:
            z = box[2, b]
            box[0, b] += growth[0, 2] * z
            box[1, b] += growth[1, 2] * z
            box[2, b] += growth[2, 0] * x + growth[2, 1] * y + growth[2, 2] * z
        box[0, b] += growth[0, 0] * x + growth[0, 1] * y
        box[1, b] += growth[1, 0] * x + growth[1, 1] * y


@kernel
def unbalance(work):
    """(largest net force on a grain, largest contact force) of the last step, N; eq. 19."""
    grain, pair = work.forces.grain, work.forces.pair
    dim = pair.shape[0]
    net = contact = 0.0
    for i in range(grain.shape[0]):
        squared = 0.0
        for a in range(dim):
            squared += grain[i, a] ** 2
        net = max(net, squared)
    for c in range(work.pairs.first[-1]):
        squared = 0.0
        for a in range(dim):
            squared += pair[a, c] ** 2
        contact = max(contact, squared)
    return math.sqrt(net), math.sqrt(contact)
