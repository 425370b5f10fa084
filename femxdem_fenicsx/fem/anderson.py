"""Anderson acceleration on a factorised Jacobian that is kept, as a type of PETSc's SNES.

PETSc has the parts, but its Anderson takes two residuals an iteration when it is preconditioned
by a linear solve, and here a residual is a law evaluation. This one takes one. It is SNES in all
else: monitors, convergence test, options; any other type can be chosen on the command line.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc


class Anderson:
    """What SNES calls for ``-snes_type python`` with this class as ``-snes_python_type``.

    With g(x) = -K^-1 F(x), K a Jacobian computed some time ago, and the last differences dX of
    iterates and dG of their g, the next iterate is x + beta g - (dX + beta dG) gamma, where gamma
    minimises |g - dG gamma| (Walker and Ni 2011). K is computed anew, and the differences start
    anew, at the first iterate of a solve, and where an iteration reduces |F| by too little, though
    not again within `PATIENCE` ones.

    Options: ``-snes_anderson_m`` (5), the number of differences kept; ``-snes_anderson_beta`` (1);
    ``-snes_anderson_slow`` (0.7), the reduction of |F| from which on K is computed anew, 0 for
    never within a solve; ``-snes_anderson_keep`` (false), whether K and the differences stay from
    solve to solve as long as they serve: of use where K costs more than some evaluations.

    Attributes:
        keep: see the options. factorised: whether K stays as it is. differences: the last (dX, dG).
    """

    SMALLEST_SINGULAR_VALUE = 1e-3  # relative; below it, differences of g are noise
    PATIENCE = 3  # iterations

    def __init__(self):
        self.m, self.beta, self.slow, self.keep = 5, 1.0, 0.7, False
        self.forget()

    def forget(self) -> None:
        """Start anew: compute K at the next iterate, know no differences."""
        self.factorised = False
        self.differences: list[tuple[PETSc.Vec, PETSc.Vec]] = []

    def setFromOptions(self, snes: PETSc.SNES) -> None:
        options = PETSc.Options(snes.getOptionsPrefix())
        self.m = options.getInt("snes_anderson_m", self.m)
        self.beta = options.getReal("snes_anderson_beta", self.beta)
        self.slow = options.getReal("snes_anderson_slow", self.slow)
        self.keep = options.getBool("snes_anderson_keep", self.keep)

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        f = snes.getFunction()[0]
        if self._stops(snes, 0, x, f, step=0.0):
            return
        if not self.keep:
            self.forget()
        self._iterate(snes, x, f)
        if snes.getConvergedReason() < 0:
            self.forget()

    def _iterate(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        before, g, norm, age = None, x.duplicate(), f.norm(), self.PATIENCE
        for iteration in range(1, snes.getTolerances()[3] + 1):
            if not self.factorised:
                self._factorise(snes, x)
                before, age = None, 0
            snes.getKSP().solve(f, g)
            if snes.getKSP().getConvergedReason() < 0:
                snes.getKSP().reset()  # or MUMPS goes on with the failed factors
                snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE)
                return
            g.scale(-1.0)
            if before is not None:
                self.differences.append((x - before[0], g - before[1]))
                del self.differences[: -self.m]
            before = x.copy(), g.copy()
            update = self._update(g)
            x.axpy(1.0, update)
            if self._stops(snes, iteration, x, f, step=update.norm()):
                return
            last, norm, age = norm, f.norm(), age + 1
            if 0.0 < self.slow * last < norm and age >= self.PATIENCE:
                self.forget()
        snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)

    def _factorise(self, snes: PETSc.SNES, x: PETSc.Vec) -> None:
        """Compute K at x; the KSP factorises it at the next solve."""
        jacobian, preconditioner = snes.getJacobian()[:2]
        snes.computeJacobian(x, jacobian, preconditioner)
        snes.getKSP().setOperators(jacobian, preconditioner)
        self.factorised = True

    def _update(self, g: PETSc.Vec) -> PETSc.Vec:
        update = g.copy()
        update.scale(self.beta)
        if self.differences:
            gram = np.array([[p.dot(q) for _, q in self.differences] for _, p in self.differences])
            right = np.array([p.dot(g) for _, p in self.differences])
            smallest = self.SMALLEST_SINGULAR_VALUE**2
            gamma = np.linalg.lstsq(gram, right, rcond=smallest)[0]
            for weight, (dx, dg) in zip(gamma, self.differences, strict=True):
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
