"""DEMQO, the DEM-based quasi-static operator (Argilaga eq. 20, Desrues eq. 32)."""

import numpy as np

from ..loading import Loading
from ..response import Response
from .kao import kruyt_augmented
from .network import objective, strains

#: Friction that no contact overcomes.
STICKING = 1e9
#: Strain of the auxiliary steps, in the strain that the stress causes (overlap by diameter in a
#: linear contact): so small that hardly a contact opens or closes.
PERTURBATION = 1e-4
#: Of the hold (Desrues eq. 19): a hundredth of the change of the stress, or less.
TOLERANCE = 1e-6
MOST_STEPS = 20000


def quasi_static(response: Response, F: np.ndarray) -> np.ndarray:
    """DEMQO: auxiliary DEM steps from the latest state, with a friction that lets nothing slide.

    C_ijmn = (S^E_ij(F + e L^mn) - S^E_ij(F)) / e. S^E(F), one auxiliary step more, is the latest
    state brought to rest: what a hold leaves unbalanced is more than the perturbation changes. The
    others start there. Strains alone are perturbed: a rotation turns the stress.
    """
    B, dim = response.size, F.shape[-1]
    loading: Loading = response.loading._replace(tolerance=TOLERANCE, hold_limit=MOST_STEPS)
    friction = None if response.material.friction is None else STICKING
    material = response.material._replace(friction=friction)
    unmoved, packings, rest = np.tile(np.eye(dim), (B, 1, 1)), np.arange(B), response.latest.copy()
    base = response.probe(unmoved, packings, response.latest, material, loading, rest).stress
    basis, size = strains(dim), _sizes(response, F)[:, None, None, None]
    motions = (np.eye(dim) + size * basis).reshape(-1, dim, dim)
    packings = np.repeat(packings, len(basis))
    stress = response.probe(motions, packings, rest, material, loading).stress
    change = stress.reshape(B, -1, dim, dim) - base[:, None]
    return objective(change / size, base)


def _sizes(response: Response, F: np.ndarray) -> np.ndarray:
    """Strain of the auxiliary steps of each packing, (B,)."""
    stress = np.linalg.norm(response.outcome.stress, axis=(1, 2))
    stiffness = np.abs(kruyt_augmented(response, F)).max(axis=(1, 2, 3, 4))
    bears = (stress > 0.0) & (stiffness > 0.0)
    return PERTURBATION * np.where(bears, stress, 1.0) / np.where(bears, stiffness, 1e3)
