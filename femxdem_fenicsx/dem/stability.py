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
    spinning = 0.5 if packing.dim == 2 else 0.4  # inertia over m R^2
    kn = contacts.stiffness[:, None]
    kt = packing.law.stiffness_ratio * kn if packing.law.friction > 0 else 0.0 * kn
    inverse_mass = (1.0 / packing.masses)[:, None]
    rng = np.random.default_rng(0)
    velocity = rng.normal(size=(packing.size, packing.dim))
    rim = rng.normal(size=(packing.size, 3)) * (1.0 if packing.dim == 3 else [0.0, 0.0, 1.0])
    value = 0.0
    for _ in range(2000):
        along = ((velocity[j] - velocity[i]) * n).sum(1)[:, None] * n
        slip = velocity[j] - velocity[i] - along - _cross(rim[i] + rim[j], n)
        force, moment = kn * along + kt * slip, kt * _cross(n, slip)
        velocity, rim = np.zeros_like(velocity), np.zeros_like(rim)
        np.add.at(velocity, j, force)
        np.subtract.at(velocity, i, force)
        np.subtract.at(rim, i, moment)
        np.subtract.at(rim, j, moment)
        velocity *= inverse_mass
        rim *= inverse_mass / spinning
        last, value = value, np.sqrt((velocity**2).sum() + (rim**2).sum())
        velocity, rim = velocity / value, rim / value
        if abs(value - last) < 1e-5 * value:
            break
    return float(2.0 / np.sqrt(value))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b; vectors in the plane have two components (n, 2), spins always three (n, 3)."""
    if b.shape[1] == 3 and a.shape[1] == 3:
        return np.cross(a, b)
    if a.shape[1] == 3:
        return a[:, 2:] * np.column_stack([-b[:, 1], b[:, 0]])
    product = np.zeros((len(a), 3))
    product[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product


def _dilute_limit(packing: Packing) -> float:
    constant, modulus = packing.law.stiffnesses
    kn = constant + modulus * packing.radii
    kt = packing.law.stiffness_ratio * kn if packing.law.friction > 0 else 0.0
    omega_squared = np.maximum(kn, 3.0 * kt) * 2.0 * 5.0 / packing.masses
    return float(2.0 / np.sqrt(omega_squared.max()))
