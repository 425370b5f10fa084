"""The contact law on the command line: options that demos and commands share."""

from __future__ import annotations

import argparse

from .dem.contacts import Bonds, ContactLaw, HertzMindlin, LinearContact, RollingResistance
from .dem.preparation import GUO_ZHAO


def add_contact_law(group: argparse._ArgumentGroup) -> None:
    """What `contact_law_for` reads."""
    group.add_argument(
        "--contact-law", default="linear", help=f"elasticity: {', '.join(CONTACT_LAWS)}"
    )
    group.add_argument("--friction", type=float, default=GUO_ZHAO.friction, help="of the contacts")
    group.add_argument(
        "--modulus", type=float, default=GUO_ZHAO.modulus, help="E_c of linear contacts, Pa"
    )
    group.add_argument(
        "--stiffness-ratio", type=float, default=GUO_ZHAO.stiffness_ratio, help="their k_t / k_n"
    )
    group.add_argument("--shear-modulus", type=float, default=4e9, help="G for hertz, Pa")
    group.add_argument("--poisson-ratio", type=float, default=0.2, help="nu for hertz")
    group.add_argument("--cohesion", type=float, default=0.0, help="of a contact, N")
    group.add_argument(
        "--rolling-friction", type=float, help="largest rolling moment over r f_n  (default: none)"
    )
    group.add_argument(
        "--bonds",
        type=float,
        nargs=2,
        metavar=("TENSION", "SHEAR"),
        help="strength of cement between grains that touch, N  (default: none)",
    )


def contact_law_for(args: argparse.Namespace) -> ContactLaw:
    """The contact law that was asked for; ValueError for values that make none."""
    rolling, bonds = args.rolling_friction, args.bonds
    shared = {
        "friction": args.friction,
        "cohesion": args.cohesion,
        "rolling": None if rolling is None else RollingResistance(rolling),
        "bonds": None if bonds is None else Bonds(*bonds),
    }
    if args.contact_law not in CONTACT_LAWS:
        known = ", ".join(CONTACT_LAWS)
        raise ValueError(f"unknown contact law '{args.contact_law}'; choose from {known}")
    return CONTACT_LAWS[args.contact_law](args, shared)


#: Elastic laws by name, from arguments and what all laws share.
CONTACT_LAWS = {
    "linear": lambda args, shared: LinearContact(
        modulus=args.modulus, stiffness_ratio=args.stiffness_ratio, **shared
    ),
    "hertz": lambda args, shared: HertzMindlin(
        shear_modulus=args.shear_modulus, poisson_ratio=args.poisson_ratio, **shared
    ),
}
