"""The longest stable time step of a packing."""

import numpy as np

from .homogenisation import touching
from .packing import Packing


def stable_time_step(packing: Packing) -> float:
    """2 / omega_max of the network of touching grains (leapfrog's limit), s.

    omega_max is the highest frequency of the contact network with all contacts sticking, found by
    power iteration on M^-1 K with K = sum of k_n n n and k_t t t over the contacts. Where nothing
    touches, the bound for a smallest grain amid five others like it is used instead (Fried's
    element bound). The network changes while a packing deforms, hence `Accuracy.time_step` < 1.
    """
    contacts = touching(packing)
    if len(contacts.pairs) == 0:
        return _dilute_limit(packing)
    i, j = contacts.pairs.T
    n = contacts.normals
    t = np.column_stack([-n[:, 1], n[:, 0]])
    kn = contacts.stiffness
    kt = packing.law.stiffness_ratio * kn if packing.law.friction > 0 else 0.0 * kn
    inverse_mass = (1.0 / packing.masses)[:, None]
    rng = np.random.default_rng(0)
    velocity, rim = rng.normal(size=(packing.size, 2)), rng.normal(size=packing.size)
    value = 0.0
    for _ in range(2000):
        relative = velocity[j] - velocity[i]
        normal = kn * (relative * n).sum(1)
        tangent = kt * ((relative * t).sum(1) - rim[i] - rim[j])
        force = normal[:, None] * n + tangent[:, None] * t
        velocity, rim = np.zeros_like(velocity), np.zeros_like(rim)
        np.add.at(velocity, j, force)
        np.subtract.at(velocity, i, force)
        np.subtract.at(rim, i, tangent)
        np.subtract.at(rim, j, tangent)
        velocity *= inverse_mass
        rim *= 2.0 * inverse_mass[:, 0]
        last, value = value, np.sqrt((velocity**2).sum() + (rim**2).sum())
        velocity, rim = velocity / value, rim / value
        if abs(value - last) < 1e-5 * value:
            break
    return float(2.0 / np.sqrt(value))


def _dilute_limit(packing: Packing) -> float:
    constant, modulus = packing.law.stiffnesses
    kn = constant + modulus * packing.radii
    kt = packing.law.stiffness_ratio * kn if packing.law.friction > 0 else 0.0
    omega_squared = np.maximum(kn, 3.0 * kt) * 2.0 * 5.0 / packing.masses
    return float(2.0 / np.sqrt(omega_squared.max()))
