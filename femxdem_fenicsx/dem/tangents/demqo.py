"""DEMQO, the DEM-based quasi-static operator (Argilaga eq. 20, Desrues eq. 32)."""

import numpy as np

from ..loading import Loading
from ..response import Response
from .network import objective, strains

#: Friction that no contact overcomes.
STICKING = 1e9
#: Strain of the auxiliary steps: far below an overlap, so that no contact opens or closes.
PERTURBATION = 1e-6
#: Of the hold (Desrues eq. 19). The change of the stress is about `PERTURBATION` times the stiffness
#: level, 1e-3 of the stress: what is left of the unbalance has to be a hundredth of that, or less.
TOLERANCE = 1e-6
MOST_STEPS = 20000


def quasi_static(response: Response, F: np.ndarray) -> np.ndarray:
    """DEMQO: auxiliary DEM steps from the latest state, with a friction that lets nothing slide.

    C_ijmn = (S^E_ij(F + e L^mn) - S^E_ij(F)) / e. S^E(F), one auxiliary step more, is the latest
    state brought to rest as well as the perturbed ones: what a hold leaves unbalanced is more than
    the perturbation changes. Strains alone are perturbed: a rotation turns the stress.
    """
    B, dim = response.size, F.shape[-1]
    basis = np.concatenate([np.zeros((1, dim, dim)), strains(dim)])
    motions = np.tile(np.eye(dim) + PERTURBATION * basis, (B, 1, 1))
    packings = np.repeat(np.arange(B), len(basis))
    loading: Loading = response.loading._replace(tolerance=TOLERANCE, hold_limit=MOST_STEPS)
    friction = None if response.material.friction is None else STICKING
    material = response.material._replace(friction=friction)
    stress = response.probe(motions, packings, response.latest, material, loading).stress
    stress = stress.reshape(B, -1, dim, dim)
    return objective((stress[:, 1:] - stress[:, :1]) / PERTURBATION, stress[:, 0])
