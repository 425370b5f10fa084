"""KAO, the Kruyt augmented operator (Argilaga eq. 18, C.4)."""

import numpy as np

from ..response import Response
from .kruyt import affine


def kruyt_augmented(response: Response, F: np.ndarray) -> np.ndarray:
    """KAO: all grains follow the strain and turn with the packing; so do the forces of contacts.

    C_ijkl = 1/V sum l^2 (k_n e_i e_j e_k e_l + k_t/2 t_i e_j (t_k e_l + e_k t_l))
    + 1/V sum l (f_n t_i - f_t e_i) e_j t_k e_l - sigma_ij d_kl + sigma_il d_jk, for dF F^-1.

    It is objective: to a spin W it answers W sigma - sigma W. In 3D t t stands for I - e e.
    """
    return affine(response, turning=True, forces=True)
