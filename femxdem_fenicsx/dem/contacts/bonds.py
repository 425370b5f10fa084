"""Brittle bonds: cement between grains, broken for good.

Desrues section 2.4.1 ends with a frictional-cemented law for sandstone without its equations.
"""

from typing import NamedTuple


class Bonds(NamedTuple):
    """Strength of the cement of a bonded contact; it is as elastic as the contact without it.

    A bonded contact pulls as it would push, f_n(-u) = -f_n(u). It breaks where its tension exceeds
    `tension` or its tangential force the sum of `shear` and Coulomb's limit, and is an ordinary
    contact ever after (Bourrier et al., Ecol. Engng 61 (2013) 646-657: brittle cohesion).
    """

    tension: float  # N
    shear: float  # N

    def holds(bonds, normal, tangential, limit):
        """Whether a bond bears the force (normal, compression positive, and tangential), N."""
        return (normal >= -bonds.tension) & (tangential <= bonds.shear + limit)
