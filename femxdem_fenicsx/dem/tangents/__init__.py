"""Tangent operators C = d sigma / d F of a batch of packings (Argilaga sections 3-5).

An operator takes the response and the last trial F (B, d, d) and returns C (B, d, d, d, d), Pa,
the derivative of the stress by F's last motion, d sigma = C : (dF F^-1). Those that remember
something from step to step hold it in `memory`, arrays whose first index is the packing.
"""

from collections.abc import Callable

import numpy as np

from ..response import Response
from .aeo import AuxiliaryElastic
from .cto import consistent_tangent
from .demqo import quasi_static
from .kao import kruyt_augmented
from .pstlo import prestressed_truss
from .secant import Secant
from .ucko import UpperBoundCorrected, UpperBoundCorrected2
from .uko import upper_bound_kruyt

Operator = Callable[[Response, np.ndarray], np.ndarray]

#: What makes the operator of that name, as in the papers but for the last, which is ours:
#: `--operator` chooses from these.
OPERATORS: dict[str, Callable[[], Operator]] = {
    "CTO": lambda: consistent_tangent,
    "AEO": AuxiliaryElastic,
    "UKO": lambda: upper_bound_kruyt,
    "UCKO": UpperBoundCorrected,
    "UCKO-2DOF": UpperBoundCorrected2,
    "KAO": lambda: kruyt_augmented,
    "DEMQO": lambda: quasi_static,
    "PSTLO": lambda: prestressed_truss,
    "PSTLO-secant": Secant,
}


def operator(name: str) -> Operator:
    """A new operator of that name; ValueError with the known names otherwise."""
    if name not in OPERATORS:
        raise ValueError(f"unknown operator '{name}'; choose from {', '.join(OPERATORS)}")
    return OPERATORS[name]()
