"""The load path: how far a step goes, what happens when it does not converge, when to stop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

from ..collective import Interrupted
from ..law import InadmissibleDeformation
from .convergence import Solution
from .indirect_control import IndirectControl, largest
from .path_following import Crossing, cross
from .problem import Problem

#: A step under indirect control is cut down to this share of the first one, and grows up to that.
SMALLEST_CONTROL, LARGEST_CONTROL = 1 / 64, 8.0


@dataclass(frozen=True)
class LoadStepping:
    """Sizes of load steps, in the unit of the load (axial strain, say).

    Attributes:
        step: first and largest step.
        smallest: a step is halved down to this one, and not further; step / 8 by default.
        looser_limit: where the smallest step does not converge either, the best iterate is
            accepted with FNORM/RNORM up to this, and counted (Desrues Table 5).
        grow_after: converged steps in a row after which a cut step doubles.
        crossing: how the specimen may move to another equilibrium where the smallest step does
            not converge (see `path_following`); None: it may not.
        indirect: whether the load becomes an unknown there (see `indirect_control`), until it has
            risen again above where it was lost. It must be prescribed displacements alone.

    Raises:
        ValueError: sizes that are not positive or out of order.
    """

    step: float
    smallest: float | None = None
    looser_limit: float = 5e-2
    grow_after: int = 3
    crossing: Crossing | None = None
    indirect: bool = False

    def __post_init__(self):
        if self.smallest is None:
            object.__setattr__(self, "smallest", self.step / 8)
        if not (0 < self.smallest <= self.step and self.looser_limit >= 0 and self.grow_after >= 1):
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
        step: its size; negative where the load goes back under indirect control.
        iterations: of the solve that was accepted.
        evaluations: of the law since the step before, those of discarded tries included.
        residual: FNORM/RNORM.
        converged: False where the best iterate was accepted under the looser limit.
        cuts: halvings so far.
        seconds: wall-clock time since the step before.
        moves: states committed on the way from one equilibrium to another; 0 for a usual step.
        work: of the reactions so far, J (per metre in 2D).
        lost_work: of what was out of balance so far, the amounts of all states added up.
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
    moves: int = 0
    work: float = 0.0
    lost_work: float = 0.0


@dataclass(frozen=True)
class Position:
    """Where a load path stands, behind an accepted step; all that `walk` needs to go on.

    Attributes:
        load: of the last accepted step.
        step: size that the next one will be tried with; 0 for the first and largest.
        in_a_row: converged steps since the last cut.
        steps: accepted so far.
        cuts: halvings.
        not_converged: steps accepted under the looser limit.
        iterations: of the accepted solves.
        evaluations: of the law.
        crossings: steps at which the specimen moved to another equilibrium.
        moves: states committed on the way.
        work, lost_work: see `StepRecord`.
        control: eps_q that the next step will be tried with under indirect control; 0: the load
            is prescribed.
        first_control: that of the first such step.
        lost_at: load where it was lost.
        controlled: steps under indirect control.
    """

    load: float = 0.0
    step: float = 0.0
    in_a_row: int = 0
    steps: int = 0
    cuts: int = 0
    not_converged: int = 0
    iterations: int = 0
    evaluations: int = 0
    crossings: int = 0
    moves: int = 0
    work: float = 0.0
    lost_work: float = 0.0
    control: float = 0.0
    first_control: float = 0.0
    lost_at: float = 0.0
    controlled: int = 0


@dataclass(frozen=True)
class Outcome(Position):
    """How a load path ended: where it stands, with the evaluations of discarded tries, and why.

    Attributes:
        lost_controllability: empty where the end was reached; otherwise one line: where the load
            path could not be followed any further, and what the solver said.
        interrupted: whether the run was asked to stop before the end.
    """

    lost_controllability: str = ""
    interrupted: bool = False


@dataclass(frozen=True)
class _Step:
    """A step that has been committed, or, with a reason, one that could not be followed."""

    iterations: int = 0
    residual: float = 0.0
    converged: bool = False
    moves: int = 0
    work: float = 0.0
    lost_work: float = 0.0
    reason: str = ""


def walk(
    problem: Problem,
    set_load: Callable[[float, float], None],
    end: float,
    stepping: LoadStepping,
    observe: Callable[[StepRecord], None] = lambda record: None,
    start: float | Position = 0.0,
    between: Callable[[Position], None] = lambda position: None,
) -> Outcome:
    """Walk the load from `start` to `end`.

    A step that does not converge is discarded, halved and tried again. Where the smallest one does
    not converge, the specimen crosses over to another equilibrium, or goes on under indirect
    control, where steps are halved likewise, if it may. If not, the best iterate is accepted under
    the looser limit; what is out of balance then stays in the residual of the next step. Beyond
    that limit the path ends there. Asked to stop (`Interrupted`), it ends behind the last accepted
    step. The last step under indirect control may lead beyond the end.

    Args:
        problem: solved step by step.
        set_load: called with the load at the start and at the end of the step to solve; it sets
            prescribed displacement increments, pressures and what else changes.
        end: of the load.
        stepping: sizes.
        observe: called after each accepted step: write results here.
        start: of the load; where an earlier walk stood, to go on with it.
        between: called with the position after each observed step: write a checkpoint here.
    """
    at = start if isinstance(start, Position) else Position(load=start)
    if not end > at.load:
        raise ValueError(f"load path from {at.load} to {end}: the end must be above the start")
    at = replace(at, step=min(at.step or stepping.step, stepping.step))
    accepted = at
    counted = problem.operator.evaluations
    clock = time.perf_counter()
    lost, interrupted = "", False
    beginning = 0.0 if isinstance(start, Position) else start
    while at.load < end and not lost:
        try:
            size, solution = _solve(problem, set_load, end, stepping, at)
        except Interrupted:  # tries that were rejected since `accepted` will be made again
            problem.reject()
            at, interrupted = accepted, True
            break
        if not solution.converged and (smaller := _smaller(problem, size, stepping, at)):
            problem.reject()
            at = smaller
            continue
        load = end if size == end - at.load else at.load + size
        if solution.converged or stepping.crossing is None:
            step = _accept(problem, size, solution, stepping.looser_limit)
        else:
            step = _cross(problem, size, stepping, lambda load=load: set_load(load, load))
        if step.reason:
            lost = f"lost controllability at load {at.load:.6g}: a step of {size:.3g} {step.reason}"
            break
        now, evaluations = time.perf_counter(), problem.operator.evaluations
        at = _behind(at, load, step, stepping)
        if at.load <= beginning:
            lost = (
                f"lost controllability at load {at.lost_at:.6g}: the path has led back to its start"
            )
        record = StepRecord(
            at.steps,
            at.load,
            size,
            step.iterations,
            evaluations - counted,
            step.residual,
            step.converged,
            at.cuts,
            now - clock,
            step.moves,
            at.work,
            at.lost_work,
        )
        at = replace(at, evaluations=at.evaluations + record.evaluations)
        clock, counted, accepted = now, evaluations, at
        observe(record)
        between(at)
    total = at.evaluations + (0 if interrupted else problem.operator.evaluations - counted)
    ended = asdict(replace(at, evaluations=total))
    return Outcome(**ended, lost_controllability=lost, interrupted=interrupted)


def _solve(problem: Problem, set_load, end: float, stepping: LoadStepping, at: Position):
    """Try the next step; the increment of the load, and how the solve ended."""
    if not at.control:
        rest = end - at.load
        size = rest if rest < at.step * (1 + 1e-6) else at.step
        set_load(at.load, at.load + size)
        return size, problem.solve(size)
    set_load(at.load, at.load + stepping.step)
    try:
        control = IndirectControl(problem, at.control)
    except InadmissibleDeformation as error:  # the first guess goes further than the law can follow
        return 0.0, Solution(False, str(error), 0, 0, math.inf)
    with control:
        solution = problem.solve(stepping.step)
    return stepping.step * problem.balance.load_share(), solution


def _smaller(
    problem: Problem, size: float, stepping: LoadStepping, at: Position
) -> Position | None:
    """Where to try again what has not converged: with a cut step; None where there is none."""
    cut = replace(at, in_a_row=0, cuts=at.cuts + 1)
    if at.control > SMALLEST_CONTROL * at.first_control:
        return replace(cut, control=at.control / 2)
    if at.control:
        return None
    if size > stepping.smallest * (1 + 1e-6):
        return replace(cut, step=max(size / 2, stepping.smallest))
    if stepping.indirect and problem.forecast.known:
        last, increment = problem.forecast.last
        first = largest(problem, increment) * stepping.smallest / last
        return replace(cut, control=first, first_control=first, lost_at=at.load)
    return None


def _accept(problem: Problem, size: float, solution: Solution, limit: float) -> _Step:
    """Commit what the solve ended with, if it is in balance to the limit."""
    if not (solution.converged or solution.residual <= limit):
        problem.reject()
        return _Step(reason=f"ends with FNORM/RNORM = {solution.residual:.2e} ({solution.reason})")
    problem.accept(abs(size) or 1.0)  # the load may stand still under indirect control
    return _Step(
        solution.iterations,
        solution.residual,
        solution.converged,
        work=problem.work,
        lost_work=abs(problem.lost_work),
    )


def _cross(
    problem: Problem, size: float, stepping: LoadStepping, hold: Callable[[], None]
) -> _Step:
    """Let the specimen move to another equilibrium, instead of the one that was not found."""
    problem.reject()
    limit = problem.convergence.force or stepping.looser_limit
    crossed = cross(problem, size, hold, limit, stepping.crossing)
    if not crossed.residual <= max(limit, stepping.looser_limit):
        return _Step(
            reason=f"has no end in balance: after {crossed.moves} moves FNORM/RNORM ="
            f" {crossed.residual:.2e} ({crossed.reason})"
        )
    return _Step(
        crossed.iterations,
        crossed.residual,
        not crossed.reason,
        crossed.moves,
        crossed.work,
        crossed.lost_work,
    )


def _behind(at: Position, load: float, ended: _Step, stepping: LoadStepping) -> Position:
    """The position behind an accepted step that ends at `load`; a cut step may grow again."""
    in_a_row = at.in_a_row + 1 if ended.converged else 0
    step, control, size = at.step, at.control, load - at.load
    grows = in_a_row >= stepping.grow_after
    if control and grows and size > 0 and load > at.lost_at:
        control, in_a_row = 0.0, 0
    elif control:
        longest = LARGEST_CONTROL * at.first_control
        in_load = control * stepping.step / max(abs(size), 1e-300)
        control = min(control * (2 if grows else 1), longest, in_load)
        in_a_row = 0 if grows else in_a_row
    elif grows and step < stepping.step:
        step, in_a_row = min(2 * step, stepping.step), 0
    return replace(
        at,
        load=load,
        step=step,
        control=control,
        controlled=at.controlled + (at.control > 0),
        in_a_row=in_a_row,
        steps=at.steps + 1,
        not_converged=at.not_converged + (not ended.converged),
        iterations=at.iterations + ended.iterations,
        crossings=at.crossings + (ended.moves > 0),
        moves=at.moves + ended.moves,
        work=at.work + ended.work,
        lost_work=at.lost_work + ended.lost_work,
    )
