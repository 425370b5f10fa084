"""The longest stable time step of a packing."""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, eigsh

from .aliasing import kernel
from .contacts.interface import stiffnesses
from .homogenisation import Contacts, elastic_response, touching
from .packing import Packing
from .reproducible import rounded_to_bits

#: Growth of an overlap that a time step must bear before it is computed anew.
GROWTH = 2.0


def stable_time_step(packing: Packing, pressure: float = 0.0) -> float:
    """2 / omega_max of the network of touching grains (leapfrog's limit), s.

    omega_max is the highest frequency of the contact network with all contacts sticking, the root
    of the largest eigenvalue of M^-1 K (by Lanczos' method, rounded) with K = sum of k_n n n,
    k_t t t and k_r over the contacts. Contacts that stiffen are taken at `GROWTH` times their
    overlap, and at least at that of a mean contact under `pressure` (Pa). Where nothing touches,
    the bound for a smallest grain amid five others like it is used instead (Fried's element bound).
    How the limit changes while the packing deforms is told by `vibration_of`.
    """
    contacts = touching(packing)
    least = packing.overlap_under(pressure)
    if len(contacts.pairs) == 0:
        return _dilute_limit(packing, GROWTH * least)
    i, j = contacts.pairs.T
    n = contacts.normals
    spinning = 0.5 if packing.dim == 2 else 0.4  # inertia over m R^2
    _, kn, kt = elastic_response(
        packing.law.elasticity,
        contacts.coefficients,
        GROWTH * np.maximum(np.abs(contacts.overlaps), least),
    )
    kn, kt = kn[:, None], kt[:, None] if packing.law.friction > 0 else 0.0 * kn[:, None]
    radii = packing.radii[contacts.pairs]
    inverse_i, inverse_j = 1.0 / radii.T[:, :, None]
    kr = 0.0 * kn
    if packing.law.rolling is not None:
        kr = packing.law.rolling.rolling_stiffness(kt, 1.0 / (inverse_i + inverse_j))
    every, shape = np.arange(len(i)), (len(i), packing.size)
    at_i, at_j = (csr_array((np.ones(len(i)), (every, grain)), shape) for grain in (i, j))
    inverse_root = 1.0 / np.sqrt(packing.masses)[:, None]

    def stiffness_over_mass(motion: np.ndarray) -> np.ndarray:
        """M^-1/2 K M^-1/2 times a vector of velocities and rim velocities, 1/s2."""
        velocity, rim = np.split(motion.reshape(packing.size, -1), [packing.dim], axis=1)
        velocity, rim = velocity * inverse_root, rim * inverse_root / np.sqrt(spinning)
        apart = at_j @ velocity - at_i @ velocity
        rim_i, rim_j = at_i @ rim, at_j @ rim
        along = (apart * n).sum(1)[:, None] * n
        slip = apart - along - _cross(rim_i + rim_j, n)
        force, moment = kn * along + kt * slip, kt * _cross(n, slip)
        couple = kr * (rim_j * inverse_j - rim_i * inverse_i)
        on_grains = at_j.T @ force - at_i.T @ force
        on_rims = at_j.T @ (couple * inverse_j - moment) - at_i.T @ (couple * inverse_i + moment)
        return (np.hstack([on_grains, on_rims / np.sqrt(spinning)]) * inverse_root).ravel()

    size = packing.size * (packing.dim + 3)
    operator = LinearOperator((size, size), stiffness_over_mass, dtype=float)
    start = np.random.default_rng(0).uniform(-1.0, 1.0, size)
    if packing.dim == 2:  # disks spin about one axis only
        start.reshape(packing.size, -1)[:, 2:4] = 0.0
    # ARPACK's last bits depend on the CPU: rounded to 1e-4, as a share of what has the same unit
    (largest,) = eigsh(operator, 1, v0=start, tol=1e-6, return_eigenvectors=False)
    mean = kn.mean() / packing.masses.mean()
    return float(2.0 / np.sqrt(mean * rounded_to_bits(largest / mean, 13)))


def vibration_of(packing: Packing, contacts: Contacts, overlap: float) -> float:
    """Largest, of all contacts (i, j), of K_i / m_i + K_j / m_j, 1/s2; 0 without contacts.

    K_i is the sum of k_n over the contacts of grain i, all at an overlap of that share of the mean
    diameter of its grains. The stable time step goes with the inverse root of this as contacts
    form and stiffen: within 2 % of 2 / omega_max on the way, where it falls by up to 22 %
    (docs/stability.md). Unlike omega_max it costs no more than a look at each contact.
    """
    if len(contacts.pairs) == 0:
        return 0.0
    i, j = contacts.pairs.T
    reach = packing.radii[i] + packing.radii[j]
    _, k_n, _ = elastic_response(packing.law.elasticity, contacts.coefficients, overlap * reach)
    over_mass = np.bincount(i, k_n, packing.size) + np.bincount(j, k_n, packing.size)
    over_mass /= packing.masses
    return float((over_mass[i] + over_mass[j]).max())


@kernel
def stiffest_contact(work, material, overlap):
    """`vibration_of` the packing in the work space: of the pairs with a force in the last step."""
    pairs, force, inverse_mass = work.pairs, work.forces.pair, material.inverse_mass
    over_mass = np.zeros(inverse_mass.size)
    for c in range(pairs.first[-1]):
        if force[0, c] != 0.0 or force[1, c] != 0.0:
            i, j = pairs.i[c], pairs.j[c]
            k_n, _ = stiffnesses(material.law, pairs.coefficient[c], overlap * pairs.reach[c])
            over_mass[i] += k_n * inverse_mass[i]
            over_mass[j] += k_n * inverse_mass[j]
    largest = 0.0
    for c in range(pairs.first[-1]):
        if force[0, c] != 0.0 or force[1, c] != 0.0:
            largest = max(largest, over_mass[pairs.i[c]] + over_mass[pairs.j[c]])
    return largest


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b; vectors in the plane have two components (n, 2), spins always three (n, 3)."""
    if b.shape[1] == 3 and a.shape[1] == 3:
        return np.cross(a, b)
    if a.shape[1] == 3:
        return a[:, 2:] * np.column_stack([-b[:, 1], b[:, 0]])
    product = np.zeros((len(a), 3))
    product[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product


def _dilute_limit(packing: Packing, overlap: float) -> float:
    law, radii = packing.law.elasticity, packing.radii
    coefficients = np.array([law.coefficient(radius, radius) for radius in radii])
    _, kn, kt = elastic_response(law, coefficients, np.full(len(radii), overlap))
    kt = kt if packing.law.friction > 0 else 0.0
    omega_squared = np.maximum(kn, 3.0 * kt) * 2.0 * 5.0 / packing.masses
    return float(2.0 / np.sqrt(omega_squared.max()))
