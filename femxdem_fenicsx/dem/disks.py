"""The three loops of a time step for disks: forces of pairs, their sum on each grain, motion.

The state and its symbols are described in `dynamics`, which calls these.
"""

import math

from .aliasing import arrays_do_not_overlap, kernel
from .contacts.interface import (
    attraction,
    elastic_force,
    holds,
    kept_share,
    rolling_limit,
    rolling_stiffness,
    stiffnesses,
    strained_overlap,
)


@kernel
def damped(force, velocity, impulse_to_velocity, damping):
    """Local non-viscous damping (Guo-Zhao eq. 18), by the sign of the velocity at mid-step."""
    sign = velocity + 0.5 * impulse_to_velocity * force
    return force - math.copysign(damping * force, sign)


@kernel
def pair_forces(
    count, box, gradient, dt, position_x, position_y, velocity_x, velocity_y, rim_speed, radius,
    first, second, shift_x, shift_y, reach, coefficient, dashpot, tangential, memory,
    law, friction, cohesion, viscosity, rolling, bonds, force_x, force_y, moment,
):  # fmt: skip
    """Forces of all pairs on their grain j, Desrues eq. 20-26 in two dimensions.

    The contact point divides the branch vector in the ratio of the radii, so that a rotation of
    the whole packing moves no contact; with eq. 21's full radii it would, by the overlap.
    """
    arrays_do_not_overlap()
    h00, h01, h10, h11 = box[0, 0], box[0, 1], box[1, 0], box[1, 1]
    l00, l01, l10, l11 = gradient[0, 0], gradient[0, 1], gradient[1, 0], gradient[1, 1]
    spin = 0.5 * (l10 - l01)
    last = memory.shape[0] - 1
    bond = None if bonds is None else 0.0
    for c in range(count):
        i, j = first[c], second[c]
        sx = position_x[j] - position_x[i] + shift_x[c]
        sy = position_y[j] - position_y[i] + shift_y[c]
        bx, by = h00 * sx + h01 * sy, h10 * sx + h11 * sy
        length = math.sqrt(bx * bx + by * by)
        inverse = 1.0 / length
        nx, ny = bx * inverse, by * inverse
        overlap = reach[c] - length
        if bonds is not None:
            bond = memory[last, c]
        strained = strained_overlap(bonds, bond, overlap)
        normal = elastic_force(law, bonds, coefficient[c], strained)
        if friction is not None or viscosity is not None:
            k_n, k_t = stiffnesses(law, coefficient[c], abs(strained))
            vx = velocity_x[j] - velocity_x[i] + l00 * bx + l01 * by
            vy = velocity_y[j] - velocity_y[i] + l10 * bx + l11 * by
            along = vx * nx + vy * ny
        if viscosity is not None:
            normal -= dashpot[c] * math.sqrt(k_n) * along if strained != 0.0 else 0.0
        if friction is not None:
            before = strained_overlap(bonds, bond, overlap + dt * along)
            kept = kept_share(law, coefficient[c], strained, before)
            lever = length / reach[c]
            slip = vy * nx - vx * ny - lever * (rim_speed[i] + rim_speed[j] + spin * reach[c])
            limit = friction * max(normal, 0.0)
            trial = kept * tangential[c] - k_t * dt * slip
            if bonds is not None:
                intact = bond > 0.0 and holds(bonds, normal, abs(trial), limit)
                memory[last, c] = 1.0 if intact else 0.0
                normal = normal if intact or overlap > 0.0 else 0.0
                limit = abs(trial) if intact else limit
            tangent = min(max(trial, -limit), limit)
            tangential[c] = tangent
            moment[c] = lever * tangent
        if rolling is not None:
            arm = radius[i] * radius[j] / (radius[i] + radius[j])
            turned = dt * (rim_speed[j] / radius[j] - rim_speed[i] / radius[i])
            couple_limit = rolling_limit(rolling, max(normal, 0.0), arm)
            couple = kept * memory[0, c] - rolling_stiffness(rolling, k_t, arm) * turned
            memory[0, c] = min(max(couple, -couple_limit), couple_limit)
        if cohesion is not None:
            normal -= attraction(cohesion, overlap)
        if friction is not None:
            force_x[c] = normal * nx - tangent * ny
            force_y[c] = normal * ny + tangent * nx
        else:
            force_x[c], force_y[c] = normal * nx, normal * ny


@kernel
def sum_forces(
    row, second, force_x, force_y, moment, memory, radius, friction, rolling, grain
):  # fmt: skip
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
            if rolling is not None:
                grain[j, 2] += memory[0, c] / radius[j]
                m -= memory[0, c] / radius[i]
        grain[i, 0], grain[i, 1], grain[i, 2] = fx, fy, m


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
