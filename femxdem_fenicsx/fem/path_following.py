"""How a load path goes on where no equilibrium is found: the specimen moves until it rests again.

Past the peak the stress of a packing falls suddenly where its grains rearrange, and the specimen
may soften faster than its plates move (snap-back). There is then no equilibrium near the last one
under the load that is asked for. A real specimen moves, quickly, to another one. So does this one,
but with a viscosity in place of its inertia.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .problem import Problem
from .viscosity import Viscosity


@dataclass(frozen=True)
class Crossing:
    """Settings of `cross`.

    Attributes:
        first_time: of the first move, in relaxation times.
        longest_time: of any.
        most_moves: give up after so many.
        growth: factor from a move to the next, longer one; a move that fails is halved.
    """

    first_time: float = 1.0
    longest_time: float = 8.0
    most_moves: int = 100
    growth: float = 1.5


@dataclass(frozen=True)
class Crossed:
    """How a specimen moved from one equilibrium to another.

    Attributes:
        moves: states committed on the way.
        iterations: of the accepted solves.
        residual: FNORM/RNORM of the last of them, without viscous forces.
        work: of the reactions, J (per metre in 2D).
        lost_work: of viscous forces and what else was out of balance: what a real specimen would
            have turned into motion.
        reason: why it is not at rest; empty where it is.
    """

    moves: int
    iterations: int
    residual: float
    work: float
    lost_work: float
    reason: str = ""


def cross(
    problem: Problem, step: float, hold: Callable[[], None], limit: float, settings: Crossing
) -> Crossed:
    """Apply the load step, hold it, and let the specimen move until it rests.

    Each move is a backward Euler step of K du/dt + R(u) = 0, with R the out-of-balance forces and
    K the Jacobian at the beginning by the law's operator. Its state is committed, so that the
    packings follow the motion. Unstable modes grow until the specimen has found another place to
    rest, stable ones die away. What has been committed cannot be taken back, so that a run that is
    asked to stop does so behind the crossing.

    Args:
        problem: behind an accepted step, with the prescribed increments of the next one.
        step: its size on the load path.
        hold: called after the first move: it sets the prescribed increments to zero.
        limit: of FNORM/RNORM, at which the specimen is at rest.
        settings: of the motion.
    """
    viscosity = Viscosity(problem.stiffness(), settings.first_time)
    operator = problem.operator
    interrupted, operator.interrupted = operator.interrupted, lambda: False
    moves, iterations, work, lost_work, residual = 0, 0, 0.0, 0.0, float("inf")
    reason = ""
    try:
        while residual > limit and not reason:
            problem.balance.viscosity = viscosity
            solution = problem.solve(step if moves == 0 else 0.0)
            if not solution.converged:
                problem.reject()
                viscosity.dt *= 0.5
                if viscosity.dt < settings.first_time / 64:
                    reason = f"a move ends with {solution.residual:.2e} ({solution.reason})"
                continue
            residual = problem.balance.without_viscosity()
            problem.accept(step, guides=False)
            moves, iterations = moves + 1, iterations + solution.iterations
            work, lost_work = work + problem.work, lost_work + abs(problem.lost_work)
            if moves == 1:
                hold()
            if moves == settings.most_moves:
                reason = f"not at rest after {moves} moves"
            viscosity.dt = min(settings.growth * viscosity.dt, settings.longest_time)
    finally:
        problem.balance.viscosity, operator.interrupted = None, interrupted
    problem.forget(for_good=True)
    return Crossed(
        moves, iterations, residual, work, lost_work, "" if residual <= limit else reason
    )
