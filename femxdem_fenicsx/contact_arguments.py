"""The contact law on the command line: options that demos and commands share."""

from __future__ import annotations

import argparse

from .dem.contacts import LinearContact
from .dem.preparation import GUO_ZHAO


def add_contact_law(group: argparse._ArgumentGroup) -> None:
    """What `contact_law` reads. A `--contact-law` that chooses among laws belongs here."""
    group.add_argument("--friction", type=float, default=GUO_ZHAO.friction, help="of the contacts")
    group.add_argument(
        "--modulus", type=float, default=GUO_ZHAO.modulus, help="E_c of the contacts, Pa"
    )
    group.add_argument(
        "--stiffness-ratio", type=float, default=GUO_ZHAO.stiffness_ratio, help="k_t / k_n"
    )
    group.add_argument("--cohesion", type=float, default=0.0, help="of a contact, N")


def contact_law(args: argparse.Namespace) -> LinearContact:
    """The law that the options describe; ValueError for values that make none."""
    return LinearContact(
        modulus=args.modulus,
        stiffness_ratio=args.stiffness_ratio,
        friction=args.friction,
        cohesion=args.cohesion,
    )
