"""Contact laws: what two grains that touch do to each other, and with which parameters.

A law is one file; docs/contact-laws.md shows the equations of these, and how to add one.
"""

from .bonds import Bonds
from .hertz_mindlin import HertzMindlin
from .law import SCHEMES, ContactLaw
from .linear import LinearContact
from .rolling import RollingResistance

__all__ = [
    "SCHEMES",
    "Bonds",
    "ContactLaw",
    "HertzMindlin",
    "LinearContact",
    "RollingResistance",
]
