"""KAO against Argilaga's C.3 differentiated numerically."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.homogenisation import tangential_vectors, touching
from femxdem_fenicsx.dem.packing import Packing
from femxdem_fenicsx.dem.response import Response
from tests.reference import reference_packing, reference_spheres

from .scenes import tangent


def moved_stress(packing: Packing, E: np.ndarray) -> np.ndarray:
    """C.3 of a packing whose grains follow I + E and turn with it (C.1-C.2), E infinitesimal.

    Normal forces from the new overlaps, tangential ones as eq. B.10 and Desrues eq. 24 change them.
    """
    dim, contacts = packing.dim, touching(packing)
    spin, b, n = 0.5 * (E - E.T), contacts.branches, contacts.normals
    branches = b @ (np.eye(dim) + E).T
    lengths = np.linalg.norm(branches, axis=1)
    normals = branches / lengths[:, None]
    overlaps = packing.radii[contacts.pairs].sum(1) - lengths
    normal = contacts.normal_force + contacts.stiffness * (overlaps - contacts.overlaps)
    T = tangential_vectors(n, contacts.tangential)
    slip = b @ (E - spin).T
    slip -= np.einsum("ci,cj,cj->ci", n, n, slip)
    # carried along with the normal, and about it with the spin of the grains
    twisted = T @ spin.T
    twisted -= np.einsum("ci,cj,cj->ci", n, n, twisted)
    T = T + twisted - n * np.einsum("ci,ci->c", T, normals)[:, None]
    T = T - contacts.tangential_stiffness[:, None] * slip
    on_j = normal[:, None] * normals + T
    volume = packing.volume * np.linalg.det(np.eye(dim) + E)
    return -on_j.T @ branches / volume


@pytest.mark.parametrize("read", [reference_packing, reference_spheres])
def test_kao_is_the_derivative_of_the_stress_of_grains_that_follow_the_packing(read):
    response = Response(read(), 1, PRESETS["fast"])
    dim = response.latest.template.dim
    F = np.eye(dim)
    F[0, 1], F[1, 1] = 1e-3, 0.998
    response.deform(F[None])  # so that tangential forces are there
    response.commit()
    packing = response.committed.packing(0)
    C, h = tangent("KAO", response), 1e-5
    for k, m in np.ndindex(dim, dim):
        E = np.zeros((dim, dim))
        E[k, m] = h
        numeric = (moved_stress(packing, E) - moved_stress(packing, -E)) / (2 * h)
        np.testing.assert_allclose(C[:, :, k, m], numeric, rtol=0, atol=1e-8 * np.abs(C).max())
