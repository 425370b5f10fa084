"""Equilibrium of one load step, solved by PETSc SNES with our residual and Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import dolfinx.fem.petsc
import h5py
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from ..collective import together
from ..law import InadmissibleDeformation
from . import _dolfinx
from .convergence import Convergence, Solution
from .external_operator import ExternalOperator
from .forecast import Forecast
from .indirect_control import IndirectControl
from .learnt import Learnt, cell_rows, from_cell_rows
from .mesh_motion import MeshMotion
from .options import PREFIX, set_from_options
from .viscosity import Viscosity

REASONS = {
    value: name
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and not name.startswith("_")
}

#: What the iteration of a step can start from, see `Problem`.
FIRST_GUESSES = ("increment", "tangent")


@dataclass(frozen=True)
class _Evaluated:
    """An iterate (owned dofs), with its FNORM and RNORM."""

    x: np.ndarray
    out_of_balance: float
    reactions: float

    @property
    def ratio(self) -> float:
        if self.out_of_balance == 0.0:
            return 0.0
        return self.out_of_balance / self.reactions if self.reactions > 0 else np.inf


class Problem:
    """One load step after the other: `solve`, then `accept` or `reject`.

    Attributes:
        snes: PETSc's solver, options prefix `femxdem_`; its command line options win over our
            defaults (see :mod:`femxdem_fenicsx.fem.options`).
        u: displacement of the step, m, on the geometry at its start; or a function of a mixed
            space that begins with it, in units of displacement too.
        operator: the external operator in the forms.
        motion: moves the mesh, and holds the total displacement.
        convergence: the criteria.
        forecast: what the increments so far say of the next one.
        viscosity: adds viscous forces, see :mod:`femxdem_fenicsx.fem.path_following`; None for
            none.
        control: makes the load an unknown, see :mod:`femxdem_fenicsx.fem.indirect_control`.
        work: of the reactions at constrained dofs in the last accepted step, J (per metre in 2D).
        lost_work: of what was out of balance there: so much more work did external forces and
            reactions than the stress has taken up.

    Args:
        u: displacement function, or a mixed one that begins with it.
        residual: UFL form, internal minus external forces.
        jacobian: UFL form, its derivative.
        operator: the external operator whose stress and tangent are in the forms.
        bcs: Dirichlet conditions on the displacement of the step. Change their values between
            steps in place (through a Constant or a Function).
        convergence: criteria.
        prefix: of the PETSc options.
        first_guess: "increment", the last increment scaled, with its change if that goes on, less
            what the last step left out of balance; or "tangent", the linear response to the
            prescribed values.

    Raises:
        ValueError: an unknown first guess.
    """

    def __init__(
        self,
        u: fem.Function,
        residual: ufl.Form,
        jacobian: ufl.Form,
        operator: ExternalOperator,
        bcs: Sequence,
        convergence: Convergence | None = None,
        prefix: str = PREFIX,
        first_guess: str = "increment",
    ):
        if first_guess not in FIRST_GUESSES:
            raise ValueError(
                f"unknown first guess '{first_guess}'; choose from {', '.join(FIRST_GUESSES)}"
            )
        self.u, self.operator, self.bcs = u, operator, list(bcs)
        self.convergence = convergence or Convergence()
        element = operator.points.element
        self.motion = MeshMotion(u, element.cell, element.degree)
        self._mesh = u.function_space.mesh
        self._comm = self._mesh.comm
        self._residual, self._jacobian = fem.form(residual), fem.form(jacobian)
        self._matrix = dolfinx.fem.petsc.create_matrix(self._jacobian)
        self._forces = _dolfinx.create_vector(self._residual, u.function_space)
        self._work = self._forces.duplicate()
        self._x = self._matrix.createVecRight()
        self._constrained, self._values = _dolfinx.prescribed(self._work, self.bcs)
        self._now: _Evaluated | None = None
        self._before: _Evaluated | None = None
        self._best: _Evaluated | None = None
        self._astray = ""
        self._failure: Exception | None = None
        self._size = self._x.local_size
        self.forecast = Forecast(u, self._size, self._norms)
        self.first_guess = first_guess
        self._last_forces: PETSc.Vec | None = None
        self.viscosity: Viscosity | None = None
        self.control: IndirectControl | None = None
        self.work = self.lost_work = 0.0
        self.snes = self._create_snes(prefix)
        self._learnt = Learnt(self.snes, self._matrix, u)

    def _create_snes(self, prefix: str) -> PETSc.SNES:
        snes = PETSc.SNES().create(self._comm)
        snes.setOptionsPrefix(prefix)
        snes.setFunction(self._function, self._matrix.createVecLeft())
        snes.setJacobian(self._assemble_jacobian, self._matrix)
        snes.setConvergenceTest(self._test)
        snes.setTolerances(atol=0.0, max_it=self.convergence.max_iterations)
        set_from_options(snes, self._matrix)
        return snes

    def solve(self, step: float = 1.0) -> Solution:
        """Solve for u under the present values of the boundary conditions and loads.

        The first guess is the last increment scaled by the ratio of the steps, with its change
        from the one before where that goes on, less what the last step left out of balance over the
        last Jacobian, which costs no evaluation. Without a last increment it is the linear response
        to the prescribed values.

        Args:
            step: size of this step on the load path; it scales the first guess, nothing else.

        Returns:
            How it ended. Not converged, u is the iterate with the smallest FNORM/RNORM.

        Raises:
            Exception: any error of the law but InadmissibleDeformation, on all ranks.
        """
        started = self.operator.evaluations
        self._now, self._astray = None, ""
        _, self._values = _dolfinx.prescribed(self._work, self.bcs)
        self._x.array[:] = self.control.guess if self.control else self._first_guess(step)
        self._now = self._before = self._best = None  # u = 0 was no iterate
        try:
            self.snes.solve(None, self._x)
        except Exception:
            if self._failure is not None:  # petsc4py may have put its own error in its place
                raise self._failure from None
            raise
        converged = self.snes.getConvergedReason() > 0
        if converged:
            self._set_u(self._x.array_r)
            self._evaluate_at_u()
            residual = self._now.ratio
        elif self._best is not None:
            self._set_u(self._best.x)
            residual = self._best.ratio
        else:
            residual = np.inf
        return Solution(
            converged,
            self._astray or REASONS[self.snes.getConvergedReason()],
            self.snes.getIterationNumber(),
            self.operator.evaluations - started,
            residual,
        )

    def accept(self, step: float = 1.0, guides: bool = True) -> None:
        """Make u the end of the step: commit the law, move the mesh, start the next step at 0.

        The law commits what it computed at this very u. `guides`: whether the first guess of the
        next step is this increment, and not that of an earlier step.
        """
        self._evaluate_at_u()
        together(self._comm, self.operator.commit)
        self.work, self.lost_work = self._works()
        self.motion.move()
        if guides:
            self.forecast.note(step, self.u.x.array[: self._size], self._now.reactions)
        self._last_forces = self._forces.copy()
        self._learnt.keep()
        self.u.x.array[:] = 0.0
        self._now = None

    def _works(self) -> tuple[float, float]:
        """(`work`, `lost_work`) of the step that ends at u, by the trapezoidal rule."""
        forces = self._forces.array_r
        if self._last_forces is not None:
            forces = 0.5 * (forces + self._last_forces.array_r)
        work = forces * self.u.x.array[: self._size]
        at_constrained = work[self._constrained].sum()
        both = np.array([at_constrained, at_constrained - work.sum()])
        return tuple(self._comm.allreduce(both).tolist())

    def stiffness(self) -> PETSc.Mat:
        """The Jacobian between two steps, of the last accepted state: a copy."""
        self._set_u(np.zeros(self._size))
        viscosity, self.viscosity = self.viscosity, None
        self._assemble_jacobian(self.snes, self._x, self._matrix, self._matrix)
        self.viscosity = viscosity
        self.forget()
        self._learnt.keep()
        return self._matrix.copy()

    def deformation_gradient(self, increment: np.ndarray) -> np.ndarray:
        """(n, d, d), of an increment from here, owned dofs. Between two steps alone."""
        self._set_u(increment)
        F = self.operator.deformation_gradient()
        self._set_u(np.zeros(self._size))
        return F

    def stress_at(self, increment: np.ndarray) -> np.ndarray:
        """Cauchy stress (n, d, d), Pa, behind an increment, owned dofs; the law is evaluated."""
        self._set_u(increment)
        self._evaluate_at_u()
        stress = self.operator.point_stress()
        self._set_u(np.zeros(self._size))
        return stress

    def forces_of(self, stress: np.ndarray) -> PETSc.Vec:
        """Internal nodal forces of a stress (n, d, d) alone, per Pa and m: a linear functional.

        Times an increment it is the integral of stress : strain. Between two steps alone.
        """
        forces, held = [], self.operator.stress.x.array.copy()
        for values in (stress, np.zeros_like(stress)):
            self.operator.set_stress(values)
            _dolfinx.assemble_vector(self._work, self._residual)
            forces.append(self._work.copy())
        self.operator.stress.x.array[:] = held
        return forces[0] - forces[1]

    def load_share(self) -> float:
        """Share of the prescribed values that u has: 1 but under indirect control."""
        u = self.u.x.array[self._constrained]
        both = np.array([self._values @ u, self._values @ self._values])
        reached, asked = self._comm.allreduce(both)
        return float(reached / asked)

    def response(self, ksp: PETSc.KSP) -> PETSc.Vec:
        """To the prescribed values alone, by the last Jacobian, which `ksp` solves with."""
        right, solution = self._work, self._x.duplicate()
        right.set(0.0)
        _dolfinx.lift(right, self._jacobian, self.bcs)
        right.array[self._constrained] = self._values
        ksp.solve(right, solution)
        return solution

    def unbalance(self) -> float:
        """FNORM/RNORM at the last iterate without viscous forces."""
        return self._measured(self._forces.array_r).ratio

    def reject(self) -> None:
        """Forget the trial and what the solver has learnt; u is zero again."""
        together(self._comm, self.operator.discard)
        self.forget()
        self.u.x.array[:] = 0.0
        self._now = None

    @property
    def residual(self) -> float:
        """FNORM/RNORM at the last iterate; NaN where there is none."""
        return np.nan if self._now is None else self._now.ratio

    def forget(self, for_good: bool = False) -> None:
        """Forget what the solver has learnt, but not the last increment: Jacobian, differences.

        `for_good`: a run that goes on from the last accepted step does not know it either.
        """
        self._learnt.forget()
        if for_good:
            self._learnt.keep()

    def save(self, group: h5py.Group) -> None:
        """Write what the next step starts from into an HDF5 group: a row per owned cell.

        That is the end of the last accepted step, and what the solver had learnt by then. Between
        steps alone: u is used for it, and is zero again afterwards.
        """
        owned = slice(_dolfinx.number_of_cells(self._mesh)[0])
        self.forecast.save(group, owned)
        group["displacement"] = _dolfinx.cell_values(self.motion.displacement)[owned]
        group["geometry"] = self._mesh.geometry.x[_dolfinx.geometry_dofmap(self._mesh)][owned]
        if self.forecast.known and self._last_forces is not None:
            group["forces"] = cell_rows(self.u, self._last_forces.array_r)[owned]
        self._learnt.save(group)

    def load(self, group: h5py.Group) -> None:
        """Read back what `save` wrote: a row per cell of this rank, ghosts included."""
        self.forecast.load(group, self._comm)
        self._last_forces = None
        if "forces" in group:  # not in the first format
            self._last_forces = self._forces.duplicate()
            self._last_forces.array[:] = from_cell_rows(self.u, group["forces"][()])
        self._learnt.load(group)
        self._now = None
        _dolfinx.set_cell_values(self.motion.displacement, group["displacement"][()])
        nodes = _dolfinx.geometry_dofmap(self._mesh)
        self._mesh.geometry.x[nodes] = group["geometry"][()]

    def reaction(self, dofs: np.ndarray) -> float:
        """Sum of the reactions (internal minus external nodal forces) at `dofs`, N per m.

        At the last iterate of the last solve, also after `accept`. `dofs`: what
        `locate_dofs_topological` finds in a component's space; those of other ranks are ignored.
        """
        owned = dofs[dofs < self._size]
        return self._comm.allreduce(float(self._forces.array_r[owned].sum()))

    # ---- first guess ----------------------------------------------------------------------------

    def _first_guess(self, step: float) -> np.ndarray:
        if self.forecast.known and self.first_guess == "increment":
            guess = self.forecast.increment(step) - self._left_over()
        else:
            guess = self._linear_response()
        guess[self._constrained] = self._values
        return guess

    def _left_over(self) -> np.ndarray:
        """What the last step left out of balance, as a displacement, by the last Jacobian."""
        if not self._learnt.assembled:
            return np.zeros(self._size)
        right = self._last_forces.copy()
        right.array[self._constrained] = 0.0
        return self._linear_solution(right)

    def _linear_response(self) -> np.ndarray:
        """One linear solve from u = 0, with the tangent there and what is out of balance there.

        That is known from the end of the last step; before the first one, the law is evaluated.
        """
        self._set_u(np.zeros(self._size))
        if not self.forecast.known or self._last_forces is None:
            self._evaluate_at_u()
            self._last_forces = self._forces.copy()
        self._assemble_jacobian(self.snes, self._x, self._matrix, self._matrix)
        right = self._work
        self._last_forces.copy(right)
        right.scale(-1.0)
        _dolfinx.lift(right, self._jacobian, self.bcs)
        right.array[self._constrained] = self._values
        return self._linear_solution(right)

    def _linear_solution(self, right: PETSc.Vec) -> np.ndarray:
        """Of the last Jacobian; zero where there is none."""
        solution, ksp = self._x.duplicate(), self.snes.getKSP()
        ksp.setOperators(self._matrix)
        ksp.solve(right, solution)
        if ksp.getConvergedReason() < 0:
            ksp.reset()  # or MUMPS goes on with the failed factors
            return np.zeros(self._size)
        return solution.array_r.copy()

    # ---- what SNES calls ------------------------------------------------------------------------

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self._set_u(x.array_r)
        try:
            self._evaluate_at_u()
        except InadmissibleDeformation as error:
            # petsc4py 3.18 cannot report a domain error: NaN stops every SNES type
            self._astray = str(error)
            f.set(np.nan)
            return
        except Exception as error:
            self._failure = error
            raise
        f.array[:] = self._total_forces()
        # under indirect control whatever load x has is right
        f.array[self._constrained] = (
            0.0 if self.control else x.array_r[self._constrained] - self._values
        )

    def _assemble_jacobian(self, snes, x: PETSc.Vec, matrix: PETSc.Mat, preconditioner) -> None:
        try:
            self.operator.evaluate_tangent()
            _dolfinx.assemble_matrix(preconditioner, self._jacobian, self.bcs)
            if self.viscosity is not None:
                self.viscosity.add_to(preconditioner)
        except Exception as error:
            self._failure = error
            raise
        self._learnt.renew()

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        reason = PETSc.SNES.ConvergedReason
        if not np.isfinite(norms[2]) or self._now is None:
            return reason.DIVERGED_FUNCTION_DOMAIN
        if self.convergence.holds(self._now.ratio, self._correction()):
            return reason.CONVERGED_FNORM_RELATIVE
        if norms[2] < snes.getTolerances()[1]:
            return reason.CONVERGED_FNORM_ABS
        return reason.ITERATING

    def _correction(self) -> float:
        """Norm of the last correction over that of u; infinite before the first correction."""
        if self._before is None:
            return np.inf
        correction, displacement = self._norms(self._now.x - self._before.x, self._now.x)
        return correction / displacement if displacement > 0 else 0.0

    # ---- evaluation -----------------------------------------------------------------------------

    def _set_u(self, owned: np.ndarray) -> None:
        self.u.x.array[: self._size] = owned
        self.u.x.scatter_forward()

    def _evaluate_at_u(self) -> None:
        """Law and nodal forces at u, unless u is where they were evaluated last."""
        x = self.u.x.array[: self._size]
        same = self._now is not None and np.array_equal(x, self._now.x)
        if self._comm.allreduce(same, MPI.LAND):
            return
        before, self._now = self._now, None
        self.operator.evaluate()
        _dolfinx.assemble_vector(self._forces, self._residual)
        self._before, self._now = before, self._measured(self._total_forces())
        if self._best is None or self._now.ratio < self._best.ratio:
            self._best = self._now

    def _total_forces(self) -> np.ndarray:
        """Internal and viscous less external nodal forces at the last iterate."""
        forces = self._forces.array_r
        return forces if self.viscosity is None else forces + self.viscosity.forces(self.u)

    def _measured(self, forces: np.ndarray) -> _Evaluated:
        free = np.delete(forces, self._constrained)
        out_of_balance, reactions = self._norms(free, forces[self._constrained])
        return _Evaluated(self.u.x.array[: self._size].copy(), out_of_balance, reactions)

    def _norms(self, *arrays: np.ndarray) -> list[float]:
        squares = np.array([np.dot(a, a) for a in arrays])
        return list(np.sqrt(self._comm.allreduce(squares)))
