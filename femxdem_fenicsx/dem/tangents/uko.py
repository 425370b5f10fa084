"""UKO, the upper bound Kruyt operator (Argilaga eq. 13, Guo-Zhao eq. 9, Desrues eq. 33)."""

import numpy as np

from ..response import Response
from .kruyt import affine


def upper_bound_kruyt(response: Response, F: np.ndarray) -> np.ndarray:
    """UKO: all grains follow the strain and do not turn, contacts are elastic.

    C = 1/V sum l^2 (k_n e e e e + k_t t e t e) over the contacts of the latest state; in 3D with
    both tangents, that is k_t (I - e e) for t t (Desrues eq. 33).

    To a rotation of the packing it answers as if its grains stayed behind: with a stress that is
    not symmetric. KAO is the same sum with grains that turn.
    """
    return affine(response)
