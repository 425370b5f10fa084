"""Equilibrium of one load step, solved by PETSc SNES with our residual and Jacobian."""

from __future__ import annotations

from collections.abc import Sequence

import dolfinx.fem.petsc
import h5py
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from ..collective import together
from ..law import InadmissibleDeformation
from . import _dolfinx
from .balance import Balance
from .convergence import Convergence, Solution
from .external_operator import ExternalOperator
from .forecast import Forecast
from .indirect_control import IndirectControl
from .learnt import Learnt, cell_rows, from_cell_rows
from .mesh_motion import MeshMotion
from .options import PREFIX, set_from_options

REASONS = {
    value: name
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and not name.startswith("_")
}

#: What the iteration of a step can start from, see `Problem`.
FIRST_GUESSES = ("increment", "tangent")


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
        balance: the nodal forces at u, and what is out of balance there.
        forecast: what the increments so far say of the next one.
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
        self.balance = Balance(u, residual, operator, self.bcs)
        element = operator.points.element
        self.motion = MeshMotion(u, element.cell, element.degree)
        self._mesh = u.function_space.mesh
        self._comm = self._mesh.comm
        self._jacobian = fem.form(jacobian)
        self._matrix = dolfinx.fem.petsc.create_matrix(self._jacobian)
        self._x = self._matrix.createVecRight()
        self._astray = ""
        self._failure: Exception | None = None
        self.forecast = Forecast(u, self.balance.size, self.balance.norms)
        self.first_guess = first_guess
        self._last_forces: PETSc.Vec | None = None
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
        self._astray = ""
        self.balance.read_prescribed()
        self.balance.restart()
        self._x.array[:] = self.control.guess if self.control else self._first_guess(step)
        self.balance.restart()  # u = 0 was no iterate
        try:
            self.snes.solve(None, self._x)
        except Exception:
            if self._failure is not None:  # petsc4py may have put its own error in its place
                raise self._failure from None
            raise
        converged = self.snes.getConvergedReason() > 0
        if converged:
            self.balance.place(self._x.array_r)
            self.balance.evaluate()
            residual = self.balance.now.ratio
        elif self.balance.best is not None:
            self.balance.place(self.balance.best.u)
            residual = self.balance.best.ratio
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
        self.balance.evaluate()
        together(self._comm, self.operator.commit)
        self.work, self.lost_work = self.balance.works(self._last_forces)
        self.motion.move()
        if guides:
            self.forecast.note(
                step, self.u.x.array[: self.balance.size], self.balance.now.reactions
            )
        self._last_forces = self.balance.forces.copy()
        self._learnt.keep()
        self.u.x.array[:] = 0.0
        self.balance.restart()

    def stiffness(self) -> PETSc.Mat:
        """The Jacobian between two steps, of the last accepted state: a copy."""
        self.balance.place(np.zeros(self.balance.size))
        viscosity, self.balance.viscosity = self.balance.viscosity, None
        self._assemble_jacobian(self.snes, self._x, self._matrix, self._matrix)
        self.balance.viscosity = viscosity
        self.forget()
        self._learnt.keep()
        return self._matrix.copy()

    def response(self, ksp: PETSc.KSP) -> PETSc.Vec:
        """To the prescribed values alone, by the last Jacobian, which `ksp` solves with."""
        right, solution = self.balance.forces.duplicate(), self._x.duplicate()
        right.set(0.0)
        _dolfinx.lift(right, self._jacobian, self.bcs)
        right.array[self.balance.constrained] = self.balance.prescribed
        ksp.solve(right, solution)
        return solution

    def reject(self) -> None:
        """Forget the trial and what the solver has learnt; u is zero again."""
        together(self._comm, self.operator.discard)
        self.forget()
        self.u.x.array[:] = 0.0
        self.balance.restart()

    @property
    def residual(self) -> float:
        """FNORM/RNORM at the last iterate; NaN where there is none."""
        return np.nan if self.balance.now is None else self.balance.now.ratio

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
            self._last_forces = self.balance.forces.duplicate()
            self._last_forces.array[:] = from_cell_rows(self.u, group["forces"][()])
        self._learnt.load(group)
        self.balance.restart()
        _dolfinx.set_cell_values(self.motion.displacement, group["displacement"][()])
        nodes = _dolfinx.geometry_dofmap(self._mesh)
        self._mesh.geometry.x[nodes] = group["geometry"][()]

    def reaction(self, dofs: np.ndarray) -> float:
        """Sum of the reactions (internal minus external nodal forces) at `dofs`, N per m.

        At the last iterate of the last solve, also after `accept`. `dofs`: what
        `locate_dofs_topological` finds in a component's space; those of other ranks are ignored.
        """
        return self.balance.reaction(dofs)

    # ---- first guess ----------------------------------------------------------------------------

    def _first_guess(self, step: float) -> np.ndarray:
        if self.forecast.known and self.first_guess == "increment":
            guess = self.forecast.increment(step) - self._left_over()
        else:
            guess = self._linear_response()
        guess[self.balance.constrained] = self.balance.prescribed
        return guess

    def _left_over(self) -> np.ndarray:
        """What the last step left out of balance, as a displacement, by the last Jacobian."""
        if not self._learnt.assembled:
            return np.zeros(self.balance.size)
        right = self._last_forces.copy()
        right.array[self.balance.constrained] = 0.0
        return self._linear_solution(right)

    def _linear_response(self) -> np.ndarray:
        """One linear solve from u = 0, with the tangent there and what is out of balance there.

        That is known from the end of the last step; before the first one, the law is evaluated.
        """
        self.balance.place(np.zeros(self.balance.size))
        if not self.forecast.known or self._last_forces is None:
            self.balance.evaluate()
            self._last_forces = self.balance.forces.copy()
        self._assemble_jacobian(self.snes, self._x, self._matrix, self._matrix)
        right = self._last_forces.copy()
        right.scale(-1.0)
        _dolfinx.lift(right, self._jacobian, self.bcs)
        right.array[self.balance.constrained] = self.balance.prescribed
        return self._linear_solution(right)

    def _linear_solution(self, right: PETSc.Vec) -> np.ndarray:
        """Of the last Jacobian; zero where there is none."""
        solution, ksp = self._x.duplicate(), self.snes.getKSP()
        ksp.setOperators(self._matrix)
        ksp.solve(right, solution)
        if ksp.getConvergedReason() < 0:
            ksp.reset()  # or MUMPS goes on with the failed factors
            return np.zeros(self.balance.size)
        return solution.array_r.copy()

    # ---- what SNES calls ------------------------------------------------------------------------

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self.balance.place(x.array_r)
        try:
            self.balance.evaluate()
        except InadmissibleDeformation as error:
            # petsc4py 3.18 cannot report a domain error: NaN stops every SNES type
            self._astray = str(error)
            f.set(np.nan)
            return
        except Exception as error:
            self._failure = error
            raise
        f.array[:] = self.balance.total()
        # under indirect control whatever load x has is right
        f.array[self.balance.constrained] = (
            0.0 if self.control else x.array_r[self.balance.constrained] - self.balance.prescribed
        )

    def _assemble_jacobian(self, snes, x: PETSc.Vec, matrix: PETSc.Mat, preconditioner) -> None:
        try:
            self.operator.evaluate_tangent()
            _dolfinx.assemble_matrix(preconditioner, self._jacobian, self.bcs)
            if self.balance.viscosity is not None:
                self.balance.viscosity.add_to(preconditioner)
        except Exception as error:
            self._failure = error
            raise
        self._learnt.renew()

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        reason = PETSc.SNES.ConvergedReason
        if not np.isfinite(norms[2]) or self.balance.now is None:
            return reason.DIVERGED_FUNCTION_DOMAIN
        if self.convergence.holds(self.balance.now.ratio, self.balance.correction()):
            return reason.CONVERGED_FNORM_RELATIVE
        if norms[2] < snes.getTolerances()[1]:
            return reason.CONVERGED_FNORM_ABS
        return reason.ITERATING
