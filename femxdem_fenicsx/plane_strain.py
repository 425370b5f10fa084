"""Plane strain: a 3D law on a 2D mesh (Desrues section 2.6)."""

import h5py
import numpy as np

from .law import Law


class PlaneStrain:
    """A 3D law whose points deform in the plane of their first two axes alone.

    To the 2D mesh it is a law of two dimensions; F_zz = 1, F_xz = F_zx = F_yz = F_zy = 0. What
    else the law tells of its points (void ratio, fabric, packings, ...) is found here too, as
    the attribute of the same name.

    Attributes:
        law: the law in 3D. dim: 2. size: number of material points.

    Args:
        law: in 3D, with its committed `stress` (n, 3, 3), Pa.

    Raises:
        ValueError: a law of another dimension.
    """

    dim = 2

    def __init__(self, law: Law):
        if law.dim != 3:
            raise ValueError(f"plane strain over a law in {law.dim}D: it must be one in 3D")
        self.law, self.size = law, law.size

    def __getattr__(self, name: str):
        if name == "law":  # not made yet
            raise AttributeError(name)
        return getattr(self.law, name)

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        """Stress in the plane (n, 2, 2), Pa, at F (n, 2, 2) relative to the committed state.

        Raises what the law raises.
        """
        if np.shape(F) != (self.size, 2, 2):
            raise ValueError(f"F has shape {np.shape(F)}, expected {(self.size, 2, 2)}")
        embedded = np.tile(np.eye(3), (self.size, 1, 1))
        embedded[:, :2, :2] = F
        return self.law.evaluate(embedded)[:, :2, :2]

    def tangent(self) -> np.ndarray:
        """C = d sigma / d F in the plane, (n, 2, 2, 2, 2), Pa, at the last trial."""
        return self.law.tangent()[:, :2, :2, :2, :2]

    def commit(self) -> None:
        """The trial becomes the state."""
        self.law.commit()

    def discard(self) -> None:
        """Forget the trial."""
        self.law.discard()

    def save(self, group: h5py.Group) -> None:
        """Write the committed state into an HDF5 group."""
        self.law.save(group)

    def load(self, group: h5py.Group) -> None:
        """Read the committed state back, bit for bit."""
        self.law.load(group)

    @property
    def stress(self) -> np.ndarray:
        """Committed stress in the plane, (n, 2, 2), Pa."""
        return self.law.stress[:, :2, :2]

    @property
    def out_of_plane_stress(self) -> np.ndarray:
        """Committed sigma_zz (n,), Pa, tension positive."""
        return self.law.stress[:, 2, 2]

    @property
    def deformation(self) -> np.ndarray:
        """Committed deformation gradient in the plane, (n, 2, 2), since the beginning."""
        return self.law.deformation[:, :2, :2]
