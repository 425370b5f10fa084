"""Nodal forces at the displacement of a step, and how far they are from balance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from . import _dolfinx
from .external_operator import ExternalOperator
from .viscosity import Viscosity


@dataclass(frozen=True)
class Iterate:
    """A displacement that was evaluated (owned dofs), m, with its FNORM and RNORM, N."""

    u: np.ndarray
    out_of_balance: float
    reactions: float

    @property
    def ratio(self) -> float:
        """FNORM/RNORM."""
        if self.out_of_balance == 0.0:
            return 0.0
        return self.out_of_balance / self.reactions if self.reactions > 0 else np.inf


class Balance:
    """Internal and viscous less external nodal forces of a step, as functions of u.

    FNORM is their norm at the free dofs, RNORM that at the constrained ones, the reactions.

    Attributes:
        u: displacement of the step, m, or a mixed function that begins with it.
        size: number of owned dofs.
        constrained: owned dofs whose values are prescribed.
        prescribed: these values, as `read_prescribed` found them.
        viscosity: adds viscous forces; None for none.
        forces: internal minus external nodal forces at the last evaluated u, N per m in 2D.
        now: the last evaluated iterate; None before the first, and where the law refused it.
        before: the one before it.
        best: the one with the smallest ratio since `restart`.

    Args:
        u: the function.
        residual: UFL form, internal minus external forces.
        operator: the external operator whose stress is in the form.
        bcs: Dirichlet conditions.
    """

    def __init__(
        self, u: fem.Function, residual: ufl.Form, operator: ExternalOperator, bcs: Sequence
    ):
        self.u, self._operator, self._bcs = u, operator, bcs
        self._comm = u.function_space.mesh.comm
        self._residual = fem.form(residual)
        self.forces = _dolfinx.create_vector(self._residual, u.function_space)
        self._work = self.forces.duplicate()
        self.size = self.forces.local_size
        self.viscosity: Viscosity | None = None
        self.read_prescribed()
        self.restart()

    def read_prescribed(self) -> None:
        """Take over the present values of the Dirichlet conditions."""
        self.constrained, self.prescribed = _dolfinx.prescribed(self._work, self._bcs)

    def restart(self) -> None:
        """Forget all iterates."""
        self.now: Iterate | None = None
        self.before: Iterate | None = None
        self.best: Iterate | None = None

    def place(self, owned: np.ndarray) -> None:
        """Let u have these values at the owned dofs, m."""
        self.u.x.array[: self.size] = owned
        self.u.x.scatter_forward()

    def evaluate(self) -> None:
        """Law and nodal forces at u, unless u is where they were evaluated last.

        Raises:
            Exception: what the operator raises, on all ranks.
        """
        u = self.u.x.array[: self.size]
        same = self.now is not None and np.array_equal(u, self.now.u)
        if self._comm.allreduce(same, MPI.LAND):
            return
        before, self.now = self.now, None
        self._operator.evaluate()
        _dolfinx.assemble_vector(self.forces, self._residual)
        self.before, self.now = before, self._measured(self.total())
        if self.best is None or self.now.ratio < self.best.ratio:
            self.best = self.now

    def total(self) -> np.ndarray:
        """Forces with the viscous ones, at the last evaluated u, owned dofs."""
        forces = self.forces.array_r
        return forces if self.viscosity is None else forces + self.viscosity.forces(self.u)

    def without_viscosity(self) -> float:
        """FNORM/RNORM at the last evaluated u without viscous forces."""
        return self._measured(self.forces.array_r).ratio

    def _measured(self, forces: np.ndarray) -> Iterate:
        free = np.delete(forces, self.constrained)
        out_of_balance, reactions = self.norms(free, forces[self.constrained])
        return Iterate(self.u.x.array[: self.size].copy(), out_of_balance, reactions)

    def correction(self) -> float:
        """Norm of the last correction over that of u; infinite before the first correction."""
        if self.before is None:
            return np.inf
        correction, displacement = self.norms(self.now.u - self.before.u, self.now.u)
        return correction / displacement if displacement > 0 else 0.0

    def works(self, last: PETSc.Vec | None) -> tuple[float, float]:
        """Of the step that ends at u, by the trapezoidal rule, J (per metre in 2D).

        Args:
            last: the forces where it began; None: as at its end.

        Returns:
            That of the reactions, and so much more than that did all forces.
        """
        forces = self.forces.array_r
        if last is not None:
            forces = 0.5 * (forces + last.array_r)
        work = forces * self.u.x.array[: self.size]
        at_constrained = work[self.constrained].sum()
        both = np.array([at_constrained, at_constrained - work.sum()])
        return tuple(self._comm.allreduce(both).tolist())

    def reaction(self, dofs: np.ndarray) -> float:
        """Sum of `forces` at these dofs, those of other ranks ignored, N (per metre in 2D)."""
        owned = dofs[dofs < self.size]
        return self._comm.allreduce(float(self.forces.array_r[owned].sum()))

    def load_share(self) -> float:
        """Share of the prescribed values that u has: 1 but under indirect control."""
        u = self.u.x.array[self.constrained]
        both = np.array([self.prescribed @ u, self.prescribed @ self.prescribed])
        reached, asked = self._comm.allreduce(both)
        return float(reached / asked)

    def norms(self, *arrays: np.ndarray) -> list[float]:
        """Euclidean norms of arrays of owned dofs, over all ranks."""
        squares = np.array([np.dot(a, a) for a in arrays])
        return list(np.sqrt(self._comm.allreduce(squares)))

    # ---- between two steps ----------------------------------------------------------------------

    def deformation_gradient(self, increment: np.ndarray) -> np.ndarray:
        """(n, d, d), of an increment from here, owned dofs."""
        self.place(increment)
        F = self._operator.deformation_gradient()
        self.place(np.zeros(self.size))
        return F

    def stress_at(self, increment: np.ndarray) -> np.ndarray:
        """Cauchy stress (n, d, d), Pa, behind an increment, owned dofs; the law is evaluated."""
        self.place(increment)
        self.evaluate()
        stress = self._operator.point_stress()
        self.place(np.zeros(self.size))
        return stress

    def forces_of(self, stress: np.ndarray) -> PETSc.Vec:
        """Internal nodal forces of a stress (n, d, d) alone, per Pa and m: a linear functional.

        Times an increment it is the integral of stress : strain.
        """
        forces, held = [], self._operator.stress.x.array.copy()
        for values in (stress, np.zeros_like(stress)):
            self._operator.set_stress(values)
            _dolfinx.assemble_vector(self._work, self._residual)
            forces.append(self._work.copy())
        self._operator.stress.x.array[:] = held
        return forces[0] - forces[1]
