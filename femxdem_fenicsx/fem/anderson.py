"""Anderson acceleration on one factorised Jacobian per load step, as a type of PETSc's SNES.

PETSc has the parts, but its Anderson takes two residuals an iteration when it is preconditioned
by a linear solve, and here a residual is a law evaluation. This one takes one. It is SNES in all
else: monitors, convergence test, options; any other type can be chosen on the command line.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc


class Anderson:
    """What SNES calls for ``-snes_type python`` with this class as ``-snes_python_type``.

    With g(x) = -K^-1 F(x), K the Jacobian at the first guess, and the last differences dX of
    iterates and dG of their g, the next iterate is x + beta g - (dX + beta dG) gamma, where gamma
    minimises |g - dG gamma| (Walker and Ni 2011).

    Options: ``-snes_anderson_m`` (5), the number of differences kept; ``-snes_anderson_beta`` (1).
    """

    SMALLEST_SINGULAR_VALUE = 1e-3  # relative; below it, differences of g are noise

    def __init__(self):
        self.m, self.beta = 5, 1.0

    def setFromOptions(self, snes: PETSc.SNES) -> None:
        options = PETSc.Options(snes.getOptionsPrefix())
        self.m = options.getInt("snes_anderson_m", self.m)
        self.beta = options.getReal("snes_anderson_beta", self.beta)

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        f, g = snes.getFunction()[0], x.duplicate()
        if self._stops(snes, 0, x, f, step=0.0):
            return
        ksp = snes.getKSP()
        jacobian, preconditioner = snes.getJacobian()[:2]
        snes.computeJacobian(x, jacobian, preconditioner)
        ksp.setOperators(jacobian, preconditioner)
        history: list[tuple[PETSc.Vec, PETSc.Vec]] = []
        for iteration in range(1, snes.getTolerances()[3] + 1):
            ksp.solve(f, g)
            if ksp.getConvergedReason() < 0:
                ksp.reset()  # or MUMPS goes on with the failed factors
                snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE)
                return
            g.scale(-1.0)
            history.append((x.copy(), g.copy()))
            del history[: -self.m - 1]
            update = self._update(history)
            x.axpy(1.0, update)
            if self._stops(snes, iteration, x, f, step=update.norm()):
                return
        snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)

    def _update(self, history: list[tuple[PETSc.Vec, PETSc.Vec]]) -> PETSc.Vec:
        x, g = history[-1]
        update = g.copy()
        update.scale(self.beta)
        differences = [(x - old_x, g - old_g) for old_x, old_g in history[:-1]]
        if differences:
            gram = np.array([[p.dot(q) for _, q in differences] for _, p in differences])
            right = np.array([p.dot(g) for _, p in differences])
            smallest = self.SMALLEST_SINGULAR_VALUE**2
            gamma = np.linalg.lstsq(gram, right, rcond=smallest)[0]
            for weight, (dx, dg) in zip(gamma, differences, strict=True):
                update.axpy(-weight, dx)
                update.axpy(-weight * self.beta, dg)
        return update

    @staticmethod
    def _stops(snes: PETSc.SNES, iteration: int, x: PETSc.Vec, f: PETSc.Vec, step: float) -> bool:
        """Evaluate the residual at x, tell the monitors, ask the convergence test."""
        snes.computeFunction(x, f)
        norm = f.norm()
        snes.setIterationNumber(iteration)
        snes.setFunctionNorm(norm)
        snes.monitor(iteration, norm)
        reasons = PETSc.SNES.ConvergedReason
        if np.isfinite(norm):
            reason = snes.callConvergenceTest(iteration, x.norm(), step, norm)
        else:
            reason = reasons.DIVERGED_FUNCTION_DOMAIN
        snes.setConvergedReason(reason)
        return reason != reasons.ITERATING
