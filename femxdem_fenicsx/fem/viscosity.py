"""Viscous nodal forces, in proportion to the displacement of a step."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc


class Viscosity:
    """Forces K u / dt: K a stiffness, u the displacement of a step, dt the time that it takes.

    Time is measured in relaxation times of the stiffness: a step of dt = 1 halves a load that K
    alone would balance.

    Args:
        stiffness: K, N/m, with ones on the diagonal of the constrained dofs.
        dt: time of a step.
    """

    def __init__(self, stiffness: PETSc.Mat, dt: float):
        self._stiffness, self.dt = stiffness, dt
        self._u, self._forces = stiffness.createVecs()

    def forces(self, u: fem.Function) -> np.ndarray:
        """At owned dofs, N (per metre in 2D)."""
        self._u.array[:] = u.x.array[: self._u.local_size]
        self._stiffness.mult(self._u, self._forces)
        return self._forces.array_r / self.dt

    def add_to(self, jacobian: PETSc.Mat) -> None:
        """Add their derivative to the Jacobian of the other forces."""
        jacobian.axpy(1.0 / self.dt, self._stiffness, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
