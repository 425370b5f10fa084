"""Operands at quadrature points -> law -> quadrature-space functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from dolfinx import fem

from ..collective import Interrupted, together
from ..law import InadmissibleDeformation, Law
from .point_state import PointState
from .quadrature_points import QuadraturePoints


class ExternalOperator:
    """The stress as a function of u, computed by a law: evaluate it, then assemble.

    Attributes:
        law: what computes the stress.
        points: its points.
        states: what the weak form remembers beside the law.
        stress: Cauchy stress, quadrature function (d, d), Pa.
        tangent: C, quadrature function (d*d, d*d), Pa.
        evaluations: how often the law was evaluated.
        interrupted: asked before each evaluation whether the run is to stop.

    Args:
        deformation_gradient: UFL expression (d, d) of the step's displacement.
        law: a law with as many points as `points` has on this rank.
        points: where to evaluate.
        largest_increment: of a component of F - I in one step; an iterate beyond it went astray,
            and a law of grains would be long in following it.
        states: what the weak form itself remembers; they live and are kept with the law's.

    Raises:
        ValueError: the law has another dimension or number of points.
    """

    def __init__(
        self,
        deformation_gradient,
        law: Law,
        points: QuadraturePoints,
        largest_increment: float = 0.5,
        states: Sequence[PointState] = (),
    ):
        self.law, self.points, self.states = law, points, tuple(states)
        self._largest = largest_increment
        mesh = points.mesh
        d = mesh.geometry.dim
        together(mesh.comm, self._check_law, d)
        self._shape = (points.size, d, d)
        self._F = fem.Expression(deformation_gradient, points.reference)
        self.stress = points.function((d, d))
        self.tangent = points.function((d * d, d * d))
        self.stress.name, self.tangent.name = "stress", "tangent"
        self._rows = points.rows(self.stress)
        self.evaluations = 0
        self.interrupted: Callable[[], bool] = lambda: False

    def _check_law(self, d: int) -> None:
        if (self.law.dim, self.law.size) != (d, self.points.size):
            raise ValueError(
                f"the law has {self.law.size} points in {self.law.dim}D, the mesh has "
                f"{self.points.size} in {d}D on this rank: make the law with points.size"
            )

    def deformation_gradient(self) -> np.ndarray:
        """Of the step, at u, (n, d, d)."""
        return self.points.evaluate(self._F, self._shape[1:])

    def evaluate(self) -> None:
        """Bring `stress` up to date with u.

        Raises:
            InadmissibleDeformation: on all ranks, where F somewhere is not finite, turns a point
                inside out or is too far from I, or where the law says so.
            Interrupted: on all ranks, where the run is to stop.
            Exception: what else the law raises, on all ranks.
        """
        comm = self.points.mesh.comm
        F = self.deformation_gradient()
        together(comm, self._check, F)  # before the law: its ranks may exchange data
        stress = together(comm, self._evaluate, F)
        self.set_stress(stress)

    def _check(self, F: np.ndarray) -> None:
        if self.interrupted():
            raise Interrupted("the run was asked to stop")
        far = np.abs(F - np.eye(F.shape[1])).max(axis=(1, 2), initial=0.0)
        with np.errstate(invalid="ignore"):
            wrong = np.flatnonzero(~((far <= self._largest) & (np.linalg.det(F) > 0)))
        if len(wrong):
            raise InadmissibleDeformation(
                f"deformation gradient {F[wrong[0]].tolist()} of one step at quadrature point "
                f"{self.points.index[wrong[0]]}: the iterate went astray or the step is too large"
            )

    def _evaluate(self, F: np.ndarray) -> np.ndarray:
        self.evaluations += 1
        stress = np.asarray(self.law.evaluate(F))
        if stress.shape != self._shape:
            raise TypeError(f"the law returned stress {stress.shape} instead of {self._shape}")
        return stress

    def point_stress(self) -> np.ndarray:
        """Values of `stress` at the points, (n, d, d), Pa."""
        rows = self.stress.x.array.reshape(-1, self._block(self.stress))[self._rows]
        return rows.reshape(self._shape)

    def set_stress(self, values: np.ndarray) -> None:
        """Let `stress` have the given values (n, d, d), Pa."""
        self._set(self.stress, values)

    def evaluate_tangent(self) -> None:
        """Bring `tangent` up to date with the last trial of the law."""
        self._set(self.tangent, together(self.points.mesh.comm, self.law.tangent))

    def commit(self) -> None:
        """Make the last trial the state of the law, and of the form's own states."""
        for state in self.states:
            state.commit()
        self.law.commit()

    def discard(self) -> None:
        """Forget the last trial."""
        self.law.discard()

    def _set(self, function: fem.Function, values: np.ndarray) -> None:
        """Values at owned points; the ghosts get those of their owners."""
        block = self._block(function)
        function.x.array.reshape(-1, block)[self._rows] = values.reshape(self.points.size, block)
        function.x.scatter_forward()

    @staticmethod
    def _block(function: fem.Function) -> int:
        return function.function_space.dofmap.index_map_bs
