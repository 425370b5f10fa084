"""The three loops of a time step for spheres: forces of pairs, their sum on each grain, motion.

As in `disks`, with vectors for the tangential force and the spin.
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
from .disks import damped


@kernel
def pair_forces(
    count, box, gradient, dt, x, y, z, vx, vy, vz, wx, wy, wz, inverse_radius,
    first, second, shift_x, shift_y, shift_z, reach, coefficient, dashpot,
    tangent_x, tangent_y, tangent_z, memory, normal_x, normal_y, normal_z,
    law, friction, cohesion, viscosity, rolling, bonds, projected, implicit,
    force_x, force_y, force_z, moment_x, moment_y, moment_z,
):  # fmt: skip
    """Forces of all pairs on their grain j, Desrues eq. 20-26.

    The tangential force of the last step is turned with the contact by the variant of the
    semi-explicit scheme (eq. 24), or projected (eq. 10), or taken along implicitly (eq. 12).
    """
    arrays_do_not_overlap()
    h00, h01, h02 = box[0, 0], box[0, 1], box[0, 2]
    h10, h11, h12 = box[1, 0], box[1, 1], box[1, 2]
    h20, h21, h22 = box[2, 0], box[2, 1], box[2, 2]
    l00, l01, l02 = gradient[0, 0], gradient[0, 1], gradient[0, 2]
    l10, l11, l12 = gradient[1, 0], gradient[1, 1], gradient[1, 2]
    l20, l21, l22 = gradient[2, 0], gradient[2, 1], gradient[2, 2]
    spin_x, spin_y, spin_z = 0.5 * (l21 - l12), 0.5 * (l02 - l20), 0.5 * (l10 - l01)
    last = memory.shape[0] - 1
    bond = None if bonds is None else 0.0
    for c in range(count):
        i, j = first[c], second[c]
        sx, sy, sz = x[j] - x[i] + shift_x[c], y[j] - y[i] + shift_y[c], z[j] - z[i] + shift_z[c]
        bx = h00 * sx + h01 * sy + h02 * sz
        by = h10 * sx + h11 * sy + h12 * sz
        bz = h20 * sx + h21 * sy + h22 * sz
        length = math.sqrt(bx * bx + by * by + bz * bz)
        inverse = 1.0 / length
        nx, ny, nz = bx * inverse, by * inverse, bz * inverse
        overlap = reach[c] - length
        if bonds is not None:
            bond = memory[last, c]
        strained = strained_overlap(bonds, bond, overlap)
        normal = elastic_force(law, bonds, coefficient[c], strained)
        if friction is not None or viscosity is not None:
            k_n, k_t = stiffnesses(law, coefficient[c], abs(strained))
            ux = vx[j] - vx[i] + l00 * bx + l01 * by + l02 * bz
            uy = vy[j] - vy[i] + l10 * bx + l11 * by + l12 * bz
            uz = vz[j] - vz[i] + l20 * bx + l21 * by + l22 * bz
            along = ux * nx + uy * ny + uz * nz
        if viscosity is not None:
            normal -= dashpot[c] * math.sqrt(k_n) * along if strained != 0.0 else 0.0
        if friction is not None:
            before = strained_overlap(bonds, bond, overlap + dt * along)
            kept = kept_share(law, coefficient[c], strained, before)
            lever = length / reach[c]
            rx = lever * (wx[i] + wx[j]) + length * spin_x
            ry = lever * (wy[i] + wy[j]) + length * spin_y
            rz = lever * (wz[i] + wz[j]) + length * spin_z
            slip_x = ux - along * nx - (ry * nz - rz * ny)
            slip_y = uy - along * ny - (rz * nx - rx * nz)
            slip_z = uz - along * nz - (rx * ny - ry * nx)
            ox = 0.5 * (wx[i] * inverse_radius[i] + wx[j] * inverse_radius[j]) + spin_x
            oy = 0.5 * (wy[i] * inverse_radius[i] + wy[j] * inverse_radius[j]) + spin_y
            oz = 0.5 * (wz[i] * inverse_radius[i] + wz[j] * inverse_radius[j]) + spin_z
            twist = dt * (ox * nx + oy * ny + oz * nz)
            fx, fy, fz = kept * tangent_x[c], kept * tangent_y[c], kept * tangent_z[c]
            off = fx * nx + fy * ny + fz * nz
            if projected is not None or implicit is not None:
                tx, ty, tz = fx - off * nx, fy - off * ny, fz - off * nz
            else:
                tx = fx - off * normal_x[c]
                ty = fy - off * normal_y[c]
                tz = fz - off * normal_z[c]
                normal_x[c], normal_y[c], normal_z[c] = nx, ny, nz
            stretch = k_t * dt
            limit = friction * max(normal, 0.0)
            if implicit is not None:
                tx, ty, tz = tx - stretch * slip_x, ty - stretch * slip_y, tz - stretch * slip_z
                turned = 1.0 + twist * twist
                squared = (tx * tx + ty * ty + tz * tz) / turned
            else:
                px = tx + twist * (ny * fz - nz * fy) - stretch * slip_x
                py = ty + twist * (nz * fx - nx * fz) - stretch * slip_y
                pz = tz + twist * (nx * fy - ny * fx) - stretch * slip_z
                squared = px * px + py * py + pz * pz
            if bonds is not None:
                intact = bond > 0.0 and holds(bonds, normal, math.sqrt(squared), limit)
                memory[last, c] = 1.0 if intact else 0.0
                normal = normal if intact or overlap > 0.0 else 0.0
                limit = 1e300 if intact else limit
            if implicit is not None:
                excess = turned * (squared / max(limit * limit, 1e-300) - 1.0)
                grown = math.sqrt(1.0 + max(excess, 0.0))
                scale = 1.0 / (grown * grown + twist * twist)
                px = scale * (grown * tx + twist * (ny * tz - nz * ty))
                py = scale * (grown * ty + twist * (nz * tx - nx * tz))
                pz = scale * (grown * tz + twist * (nx * ty - ny * tx))
                cut = 1.0 if limit > 0.0 else 0.0
            else:
                cut = min(limit / max(math.sqrt(squared), 1e-300), 1.0)
            tx, ty, tz = cut * px, cut * py, cut * pz
            tangent_x[c], tangent_y[c], tangent_z[c] = tx, ty, tz
            moment_x[c] = lever * (ny * tz - nz * ty)
            moment_y[c] = lever * (nz * tx - nx * tz)
            moment_z[c] = lever * (nx * ty - ny * tx)
        if rolling is not None:
            arm = 1.0 / (inverse_radius[i] + inverse_radius[j])
            rx = wx[j] * inverse_radius[j] - wx[i] * inverse_radius[i]
            ry = wy[j] * inverse_radius[j] - wy[i] * inverse_radius[i]
            rz = wz[j] * inverse_radius[j] - wz[i] * inverse_radius[i]
            about = rx * nx + ry * ny + rz * nz
            fx, fy, fz = kept * memory[0, c], kept * memory[1, c], kept * memory[2, c]
            off = fx * nx + fy * ny + fz * nz
            turn = dt * rolling_stiffness(rolling, k_t, arm)
            px = fx - off * nx + twist * (ny * fz - nz * fy) - turn * (rx - about * nx)
            py = fy - off * ny + twist * (nz * fx - nx * fz) - turn * (ry - about * ny)
            pz = fz - off * nz + twist * (nx * fy - ny * fx) - turn * (rz - about * nz)
            size = math.sqrt(px * px + py * py + pz * pz)
            most = rolling_limit(rolling, max(normal, 0.0), arm)
            cut = min(most / max(size, 1e-300), 1.0)
            memory[0, c], memory[1, c], memory[2, c] = cut * px, cut * py, cut * pz
        if cohesion is not None:
            normal -= attraction(cohesion, overlap)
        if friction is not None:
            force_x[c] = normal * nx + tx
            force_y[c] = normal * ny + ty
            force_z[c] = normal * nz + tz
        else:
            force_x[c], force_y[c], force_z[c] = normal * nx, normal * ny, normal * nz


@kernel
def sum_forces(
    row, second, force_x, force_y, force_z, moment_x, moment_y, moment_z, memory, inverse_radius,
    friction, rolling, grain,
):  # fmt: skip
    """Net force and moment of every grain."""
    arrays_do_not_overlap()
    grains = row.size - 1
    for i in range(grains):
        for a in range(8):
            grain[i, a] = 0.0
    for i in range(grains):
        fx, fy, fz = grain[i, 0], grain[i, 1], grain[i, 2]
        mx, my, mz = grain[i, 4], grain[i, 5], grain[i, 6]
        for c in range(row[i], row[i + 1]):
            j = second[c]
            grain[j, 0] += force_x[c]
            grain[j, 1] += force_y[c]
            grain[j, 2] += force_z[c]
            fx -= force_x[c]
            fy -= force_y[c]
            fz -= force_z[c]
            if friction is not None:
                grain[j, 4] -= moment_x[c]
                grain[j, 5] -= moment_y[c]
                grain[j, 6] -= moment_z[c]
                mx -= moment_x[c]
                my -= moment_y[c]
                mz -= moment_z[c]
            if rolling is not None:
                grain[j, 4] += memory[0, c] * inverse_radius[j]
                grain[j, 5] += memory[1, c] * inverse_radius[j]
                grain[j, 6] += memory[2, c] * inverse_radius[j]
                mx -= memory[0, c] * inverse_radius[i]
                my -= memory[1, c] * inverse_radius[i]
                mz -= memory[2, c] * inverse_radius[i]
        grain[i, 0], grain[i, 1], grain[i, 2] = fx, fy, fz
        grain[i, 4], grain[i, 5], grain[i, 6] = mx, my, mz


@kernel
def move(box, dt, damping, inverse_mass, grain, friction, x, y, z, vx, vy, vz, wx, wy, wz):
    """Leapfrog: velocities from forces, reduced positions from velocities."""
    arrays_do_not_overlap()
    a, b, c = box[0, 0], box[0, 1], box[0, 2]
    d, e, f = box[1, 0], box[1, 1], box[1, 2]
    g, h, k = box[2, 0], box[2, 1], box[2, 2]
    scale = dt / (a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g))
    i00, i01, i02 = scale * (e * k - f * h), scale * (c * h - b * k), scale * (b * f - c * e)
    i10, i11, i12 = scale * (f * g - d * k), scale * (a * k - c * g), scale * (c * d - a * f)
    i20, i21, i22 = scale * (d * h - e * g), scale * (b * g - a * h), scale * (a * e - b * d)
    for i in range(inverse_mass.size):
        impulse = dt * inverse_mass[i]
        u = vx[i] + impulse * damped(grain[i, 0], vx[i], impulse, damping)
        v = vy[i] + impulse * damped(grain[i, 1], vy[i], impulse, damping)
        w = vz[i] + impulse * damped(grain[i, 2], vz[i], impulse, damping)
        vx[i], vy[i], vz[i] = u, v, w
        x[i] += i00 * u + i01 * v + i02 * w
        y[i] += i10 * u + i11 * v + i12 * w
        z[i] += i20 * u + i21 * v + i22 * w
        if friction is not None:
            impulse *= 2.5  # a sphere's inertia is 2 m R^2 / 5
            wx[i] += impulse * damped(grain[i, 4], wx[i], impulse, damping)
            wy[i] += impulse * damped(grain[i, 5], wy[i], impulse, damping)
            wz[i] += impulse * damped(grain[i, 6], wz[i], impulse, damping)
