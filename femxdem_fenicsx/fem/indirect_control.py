"""Indirect displacement control: the load is an unknown, a local strain is prescribed.

Past the peak a specimen may soften faster than its plates move: held at its ends, it has no
equilibrium near the last one, while the plates would have to go back for one (snap-back). The
strain where the specimen fails goes on all the time, and is prescribed instead of the load
(de Borst 1987, Computation of post-bifurcation and post-failure behavior of strain-softening
solids, Computers & Structures 25, 211-224). With R(u) the out-of-balance forces at the free dofs,
u the displacement of the step and theta the load:

    R(u) = 0,    u = theta g at the prescribed dofs,    c . u = s

c . u is the deviatoric strain of one point in the direction of its last increment. Of the points
whose last increment was not much smaller than the largest of all, it is the one that softens most:
in a specimen that is strained evenly they differ in nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

if TYPE_CHECKING:
    from .problem import Problem


#: A point can be chosen from this share of the largest increment up.
LARGE = 0.5


class IndirectControl:
    """Lets a `Problem` solve for the load too, within a `with` statement.

    The iterates of SNES stay on c . u = s: the first guess is there, and every correction y of the
    solver's own KSP becomes y - (c . y)/(c . v) v, where v is the response of the Jacobian to the
    load g. That is a preconditioner of PETSc around the KSP, so that every type of SNES does it.

    Args:
        problem: behind an accepted step. Its load is displacements prescribed in proportion to it.
        size: largest increment of deviatoric strain in the first guess, the last increment scaled
            (eps_q, Guo-Zhao eq. 13); s is what the chosen point has there.

    Raises:
        InadmissibleDeformation: on all ranks, where the law cannot follow the first guess.
    """

    def __init__(self, problem: Problem, size: float):
        self._problem = problem
        self._inner = problem.snes.getKSP()
        self._outer = PETSc.KSP().create(problem.snes.comm)
        self._outer.setType("preonly")
        self._outer.getPC().setType("python")
        self._outer.getPC().setPythonContext(self)
        self._v: PETSc.Vec | None = None
        last = problem.forecast.last[1]
        self.guess = size / largest(problem, last) * last
        self._c = self._aim()

    def __enter__(self) -> IndirectControl:
        self._problem.forget()  # the first correction shall have a Jacobian, and a v, of its own
        self._problem.control = self
        self._problem.snes.setKSP(self._outer)
        return self

    def __exit__(self, *_) -> None:
        self._problem.control = None
        self._problem.snes.setKSP(self._inner)

    def _aim(self) -> PETSc.Vec:
        """c, for the point with the smallest stiffness along the first guess."""
        problem, points = self._problem, self._problem.operator.points
        e = deviator(problem, self.guess)
        change = problem.balance.stress_at(self.guess) - problem.balance.stress_at(0.0 * self.guess)
        squares = (e**2).sum(axis=(1, 2))
        stiffness = (change * e).sum(axis=(1, 2)) / np.maximum(squares, 1e-300)
        comm = points.mesh.comm
        most = comm.allreduce(squares.max(initial=0.0), MPI.MAX)
        large = np.flatnonzero(squares >= LARGE**2 * most)
        here = min(zip(stiffness[large], points.index[large], strict=True), default=(np.inf, 0))
        chosen = comm.allreduce(here, MPI.MIN)[1]
        weight = np.where(points.index == chosen, 1.0 / points.volumes(), 0.0)
        direction = e * np.sqrt(2.0 / np.maximum(squares, 1e-300))[:, None, None]
        return problem.balance.forces_of(weight[:, None, None] * direction)

    # ---- what PETSc's PC calls ------------------------------------------------------------------

    def setUp(self, pc: PETSc.PC) -> None:
        self._inner.reset()
        self._inner.setOperators(*pc.getOperators())
        self._v = None

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        if self._v is None:
            self._v = self._problem.response(self._inner)
        self._inner.solve(x, y)
        y.axpy(-self._c.dot(y) / self._c.dot(self._v), self._v)


def deviator(problem: Problem, increment: np.ndarray) -> np.ndarray:
    """Of the strain (n, d, d) of an increment from here; owned dofs."""
    F = problem.balance.deformation_gradient(increment)
    strain = 0.5 * (F + np.swapaxes(F, 1, 2)) - np.eye(F.shape[1])
    mean = np.trace(strain, axis1=1, axis2=2) / F.shape[1]
    return strain - mean[:, None, None] * np.eye(F.shape[1])


def largest(problem: Problem, increment: np.ndarray) -> float:
    """Largest eps_q of an increment from here, in the whole specimen."""
    squares = (deviator(problem, increment) ** 2).sum(axis=(1, 2))
    most = problem.operator.points.mesh.comm.allreduce(squares.max(initial=0.0), MPI.MAX)
    return float(np.sqrt(2.0 * most))
