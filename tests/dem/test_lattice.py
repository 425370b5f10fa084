"""Closed forms of regular lattices: every grain follows the strain, so that moduli are sums."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.packing import Packing
from femxdem_fenicsx.dem.response import Response

from .scenes import hexagonal

STIFFNESS, RATIO, THICKNESS = 1e6, 0.7, 0.1
#: Overlap of the contacts, and the strain that probes them: so small that neither shows at 1e-6.
OVERLAP, STRAIN = 1e-7, 1e-8


def moduli(packing: Packing, strain: np.ndarray) -> np.ndarray:
    """Central difference of the stress by a strain of this shape (d, d), Pa."""
    response = Response(packing, 1, PRESETS["balanced"])
    identity = np.eye(packing.dim)
    forth = response.deform((identity + STRAIN * strain)[None]).stress[0]
    back = response.deform((identity - STRAIN * strain)[None]).stress[0]
    return (forth - back) / (2 * STRAIN)


@pytest.mark.parametrize("friction", [0.0, 1e6])
def test_a_hexagonal_lattice_has_the_moduli_of_its_bonds(friction):
    """lambda = sqrt(3)/4 (k_n - k_t) / t and mu = sqrt(3)/4 (k_n + k_t) / t, isotropic."""
    law = LinearContact(stiffness=STIFFNESS, stiffness_ratio=RATIO, friction=friction)
    packing = hexagonal(overlap=OVERLAP, law=law)
    kt = RATIO * STIFFNESS if friction else 0.0
    scale = np.sqrt(3) / 4 / THICKNESS
    lame, shear = scale * (STIFFNESS - kt), scale * (STIFFNESS + kt)
    for strain in ([[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 0.5], [0.5, 0]]):
        strain = np.array(strain, dtype=float)
        expected = lame * np.trace(strain) * np.eye(2) + 2 * shear * strain
        np.testing.assert_allclose(moduli(packing, strain), expected, atol=1e-6 * (lame + shear))


@pytest.mark.parametrize("friction", [0.0, 1e6])
def test_a_cubic_lattice_has_the_moduli_of_its_bonds(friction):
    """C_1111 = k_n / l, C_1122 = 0, C_1212 = k_t / (2 l): bonds along the three axes."""
    law = LinearContact(stiffness=STIFFNESS, stiffness_ratio=RATIO, friction=friction)
    radius, cells = 5e-3, 5
    length = 2 * radius * (1 - OVERLAP)
    places = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), -1).reshape(-1, 3)
    packing = Packing(
        np.eye(3) * cells * length, (places + 0.5) / cells, np.full(len(places), radius), law
    )
    kt = RATIO * STIFFNESS if friction else 0.0
    stretch, shear = np.zeros((3, 3)), np.zeros((3, 3))
    stretch[0, 0] = 1.0
    shear[0, 1] = shear[1, 0] = 0.5
    tolerance = 1e-6 * STIFFNESS / length
    expected = STIFFNESS / length * stretch
    np.testing.assert_allclose(moduli(packing, stretch), expected, atol=tolerance)
    expected = kt / length * shear
    np.testing.assert_allclose(moduli(packing, shear), expected, atol=tolerance)
