"""What a packing looks like inside: contacts per grain, rattlers, shares of what bears load."""

from dataclasses import dataclass

import numpy as np

from .homogenisation import Contacts, coordination_number, fabric, fabric_anisotropy, touching
from .packing import Packing


def contact_numbers(packing: Packing, contacts: Contacts | None = None) -> np.ndarray:
    """Contacts of every grain (N,), integers."""
    contacts = contacts or touching(packing)
    return np.bincount(contacts.pairs.ravel(), minlength=packing.size)


def rattlers(packing: Packing, contacts: Contacts | None = None) -> np.ndarray:
    """(N,) bool: grains that bear no load, since they have too few contacts to be in equilibrium.

    That is fewer than 2 contacts with friction and fewer than d + 1 without; a contact with a
    rattler does not count, so that the search goes on until nothing changes.
    """
    contacts = contacts or touching(packing)
    fewest = 2 if packing.law.friction > 0 else packing.dim + 1
    free = np.zeros(packing.size, bool)
    while True:
        bearing = contacts.pairs[~free[contacts.pairs].any(1)]
        now = np.bincount(bearing.ravel(), minlength=packing.size) < fewest
        if (now == free).all():
            return free
        free = now


@dataclass(frozen=True)
class Structure:
    """Numbers that describe a packing; see `structure_of`."""

    void_ratio: float
    coordination_number: float
    bearing_coordination_number: float
    rattlers: float
    fabric_anisotropy: float
    sliding: float
    largest_overlap: float


def structure_of(packing: Packing) -> Structure:
    """Void ratio, contacts and fabric of a packing.

    `bearing_coordination_number` leaves rattlers and their contacts out (0 if all are); `rattlers`
    is their share of the grains; `sliding` the share of the contacts whose tangential force is at
    the Coulomb limit to 0.1 % (bonds count as any contact); `largest_overlap` is over the mean
    diameter of the two grains.
    """
    contacts = touching(packing)
    free = rattlers(packing, contacts)
    bearing = (~free[contacts.pairs].any(1)).sum()
    tangential = contacts.forces + contacts.normal_force[:, None] * contacts.normals
    limit = packing.law.friction * (contacts.normal_force + packing.law.cohesion)
    slides = np.linalg.norm(tangential, axis=1) > 0.999 * np.maximum(limit, 0.0)
    reach = packing.radii[contacts.pairs].sum(1)
    return Structure(
        packing.void_ratio,
        coordination_number(packing, contacts),
        2.0 * bearing / max((~free).sum(), 1),
        float(free.mean()),
        float(fabric_anisotropy(fabric(contacts))),
        float(slides.mean()) if packing.law.friction > 0 and len(slides) else 0.0,
        float((contacts.overlaps / reach).max(initial=0.0)),
    )
