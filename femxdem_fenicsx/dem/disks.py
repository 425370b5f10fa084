"""The three loops of a time step for disks: forces of pairs, their sum on each grain, motion.

The state and its symbols are described in `dynamics`, which calls these.
"""

import math

from .aliasing import arrays_do_not_overlap, kernel


@kernel
def damped(force, velocity, impulse_to_velocity, damping):
    """Local non-viscous damping (Guo-Zhao eq. 18), by the sign of the velocity at mid-step."""
    sign = velocity + 0.5 * impulse_to_velocity * force
    return force - math.copysign(damping * force, sign)


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
