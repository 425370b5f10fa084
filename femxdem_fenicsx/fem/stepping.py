"""The load path: how far a step goes, what happens when it does not converge, when to stop."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from .problem import Problem


@dataclass(frozen=True)
class LoadStepping:
    """Sizes of load steps, in the unit of the load (axial strain, say).

    Attributes:
        step: first and largest step.
        smallest: a step is halved down to this one, and not further; step / 8 by default.
        looser_limit: where the smallest step does not converge either, the best iterate is
            accepted with FNORM/RNORM up to this, and counted (Desrues Table 5).
        grow_after: converged steps in a row after which a cut step doubles.

    Raises:
        ValueError: sizes that are not positive or out of order.
    """

    step: float
    smallest: float | None = None
    looser_limit: float = 5e-2
    grow_after: int = 3

    def __post_init__(self):
        if self.smallest is None:
            object.__setattr__(self, "smallest", self.step / 8)
        if not 0 < self.smallest <= self.step or self.looser_limit < 0 or self.grow_after < 1:
            raise ValueError(
                f"load steps from {self.smallest} to {self.step}, looser limit "
                f"{self.looser_limit}, growing after {self.grow_after}: sizes must be positive "
                "and the smallest not above the step"
            )


@dataclass(frozen=True)
class StepRecord:
    """One accepted step.

    Attributes:
        number: of the step, from 1.
        load: at its end.
        step: its size.
        iterations: of the solve that was accepted.
        evaluations: of the law since the step before, those of discarded tries included.
        residual: FNORM/RNORM.
        converged: False where the best iterate was accepted under the looser limit.
        cuts: halvings so far.
        seconds: wall-clock time since the step before.
    """

    number: int
    load: float
    step: float
    iterations: int
    evaluations: int
    residual: float
    converged: bool
    cuts: int
    seconds: float


@dataclass(frozen=True)
class Outcome:
    """How a load path ended.

    Attributes:
        load: of the last accepted step.
        steps: accepted.
        cuts: halvings.
        not_converged: steps accepted under the looser limit.
        iterations: of the accepted solves.
        evaluations: of the law.
        lost_controllability: empty where the end was reached; otherwise one line: where the load
            path could not be followed any further, and what the solver said.
    """

    load: float
    steps: int
    cuts: int
    not_converged: int
    iterations: int
    evaluations: int
    lost_controllability: str = ""


def walk(
    problem: Problem,
    set_load: Callable[[float, float], None],
    end: float,
    stepping: LoadStepping,
    observe: Callable[[StepRecord], None] = lambda record: None,
    start: float = 0.0,
) -> Outcome:
    """Walk the load from `start` to `end`.

    A step that does not converge is discarded, halved and tried again. Where the smallest one does
    not converge, its best iterate is accepted under the looser limit; what is out of balance then
    stays in the residual of the next step. Beyond that limit the path ends there.

    Args:
        problem: solved step by step.
        set_load: called with the load at the start and at the end of the step to solve; it sets
            prescribed displacement increments, pressures and what else changes.
        end: of the load.
        stepping: sizes.
        observe: called after each accepted step: write results here.
        start: of the load; above zero to go on with an earlier path.
    """
    if not end > start:
        raise ValueError(f"load path from {start} to {end}: the end must be above the start")
    load, step, in_a_row = start, stepping.step, 0
    steps = cuts = not_converged = iterations = 0
    first = counted = problem.operator.evaluations
    clock = time.perf_counter()
    lost = ""
    while load < end:
        rest = end - load
        size = rest if rest < step * (1 + 1e-6) else step
        set_load(load, load + size)
        solution = problem.solve(size)
        if not solution.converged:
            in_a_row = 0
            if size > stepping.smallest * (1 + 1e-6):
                problem.reject()
                step = max(size / 2, stepping.smallest)
                cuts += 1
                continue
            if not solution.residual <= stepping.looser_limit:
                problem.reject()
                lost = (
                    f"lost controllability at load {load:.6g}: a step of {size:.3g} ends with "
                    f"FNORM/RNORM = {solution.residual:.2e} ({solution.reason})"
                )
                break
        problem.accept(size)
        load = end if size == rest else load + size
        steps += 1
        iterations += solution.iterations
        not_converged += not solution.converged
        in_a_row += solution.converged
        if in_a_row >= stepping.grow_after and step < stepping.step:
            step, in_a_row = min(2 * step, stepping.step), 0
        now, evaluations = time.perf_counter(), problem.operator.evaluations
        observe(
            StepRecord(
                steps,
                load,
                size,
                solution.iterations,
                evaluations - counted,
                solution.residual,
                solution.converged,
                cuts,
                now - clock,
            )
        )
        clock, counted = now, evaluations
    total = problem.operator.evaluations - first
    return Outcome(load, steps, cuts, not_converged, iterations, total, lost)
