"""One material point under mixed control: strain prescribed in some components, stress in others.

Works with anything that evaluates, commits and discards like a law (see `femxdem_fenicsx.law`).
"""

from dataclasses import dataclass

import numpy as np

from .preparation import NotReached
from .reproducible import determinant, inner, inverse, product, rounded

#: Growth of a correction from one evaluation to the next at most: grains answer with some scatter,
#: from which a secant can conclude anything.
LARGEST_GROWTH = 3.0
#: Least share of the contacts' own stiffness that a search reckons with where answers scatter.
SOFTEST = 0.05
#: Share of the committed pressure below which a trial has lost its contacts.
EMPTY = 0.02
#: Times that an increment is cut in two where the stress is not reached.
MOST_CUTS = 2
#: Evaluations without anything better after which a search is given up.
PATIENCE = 4
#: Off the target by that many tolerances, an increment is not cut any more: several components at
#: once scatter by as much where the grains are few.
CLOSE = 5.0
#: Off the target by more than that many tolerances, a stress that does not jump is not reached.
FAR = 20.0
#: Width of an interval, over the increment's own strain, in which a stress that changes sign but
#: does not come near its target is a jump: grains yield suddenly, and no state lies in between.
JUMP = 1e-2


@dataclass(frozen=True)
class ElementState:
    """State after an increment.

    deformation (d, d) since the beginning; stress (d, d) Pa, tension positive; evaluations of the
    law in this increment; error: largest stress component off its target, Pa; reached: within the
    tolerance, or only within the looser one.
    """

    deformation: np.ndarray
    stress: np.ndarray
    evaluations: int
    error: float
    reached: bool = True

    @property
    def axial_strain(self) -> float:
        """Engineering strain along the last axis, compression positive."""
        return 1.0 - float(self.deformation[-1, -1])

    @property
    def volumetric_strain(self) -> float:
        """det F - 1, dilation positive."""
        return float(determinant(self.deformation)) - 1.0

    @property
    def shear_strain(self) -> float:
        """gamma = F_1d, the displacement along the first axis over the height along the last."""
        return float(self.deformation[0, -1])

    @property
    def stress_ratio(self) -> float:
        """Axial over lateral stress."""
        return float(self.stress[-1, -1] / self.stress[0, 0])

    @property
    def pressure(self) -> float:
        """Mean pressure, Pa, compression positive."""
        return -float(np.trace(self.stress)) / len(self.stress)


@dataclass(frozen=True)
class StressCondition:
    """As many linear conditions on the stress as components of F are free.

    free: (d, d) bool, the m components of F that the conditions determine. rows: (m, d, d), and
    values: (m,) Pa, in rows : sigma = values.
    """

    free: np.ndarray
    rows: np.ndarray
    values: np.ndarray

    @classmethod
    def components(cls, controlled: np.ndarray, target: np.ndarray) -> "StressCondition":
        """Stress components prescribed one by one: where controlled (d, d), as in target (d, d)."""
        places = np.argwhere(controlled)
        rows = np.zeros((len(places), *np.shape(controlled)))
        rows[(np.arange(len(places)), *places.T)] = 1.0
        return cls(np.asarray(controlled, bool), rows, np.asarray(target, float)[controlled])

    def excess(self, stress: np.ndarray) -> np.ndarray:
        """(m,) Pa: by how much a stress (d, d) exceeds what is prescribed."""
        return inner(self.rows, stress) - self.values

    @classmethod
    def none(cls, dim: int) -> "StressCondition":
        """All strain is prescribed."""
        return cls.components(np.zeros((dim, dim), bool), np.zeros((dim, dim)))


class _Search:
    """Looks for the free components of F at which a law's stress meets the conditions."""

    def __init__(
        self,
        law,
        F: np.ndarray,
        condition: StressCondition,
        origin: np.ndarray,
        pressure: float = 0.0,
    ):
        """From the first guess F (d, d); F is relative to the same as `origin`, the F committed.

        pressure: mean one committed, Pa; a trial that keeps next to nothing of it has been emptied.
        """
        self.law, self.condition = law, condition
        self.F, self.best_F = np.array(F, float), None
        self.inverse = inverse(origin)
        self.best, self.evaluations, self.jump = np.inf, 0, False
        self.least_move = np.abs(F - origin).max()
        self._below = self._above = None
        self._least_pressure, self._bearing, self._filling = EMPTY * pressure, None, None

    def run(self, tolerance: float, most: int, patience: int | None = None) -> bool:
        """Whether the tolerance (Pa) is met; what was met best stays in `best` and `best_F`.

        The first correction takes the law's own stiffness at the state, further ones what the law
        was seen to answer (see `_measured`). A single component is bracketed as soon as
        its stress has been seen on both sides of the target, and `jump` says that it jumps there.
        The search ends after `patience` evaluations without anything better.
        """
        found_at, patience = 0, patience or most
        free, before, jacobian, scattered = self.condition.free, None, None, False
        longest = np.inf
        while self.evaluations < most:
            try:
                residual = self._residual()
            except (ValueError, FloatingPointError):
                if before is None:
                    raise
                self.F[free] = before[0] + 0.25 * (self.F[free] - before[0])
                continue
            error = float(np.abs(residual).max(initial=0.0))
            if self.evaluations - found_at > patience and error >= self.best:
                break
            if error < self.best:
                found_at = self.evaluations
                self.best, self.best_F, self.best_stress = error, self.F.copy(), self.stress
            if error <= tolerance:
                return True
            if -np.trace(self.stress) < self._least_pressure * len(self.F):
                found_at, scattered = self.evaluations, True
                self._fill(residual)
                continue
            self._bearing = self.F[free]
            if jacobian is None:
                jacobian = first = self._stiffness()
            else:
                move = self.F[free] - before[0]
                scattered = scattered or error > np.abs(before[1]).max()
                jacobian = self._measured(jacobian, first, move, residual - before[1], scattered)
            before = self.F[free], residual
            if len(residual) == 1 and self._bracketed(residual[0]):
                if self.jump:
                    break
                continue
            try:
                move = -rounded(np.linalg.solve(jacobian, residual))
            except np.linalg.LinAlgError:  # the stress does not answer
                break
            length = np.abs(move).max()
            if length == 0 or not np.isfinite(length):
                break
            move *= min(1.0, longest / length)
            longest = LARGEST_GROWTH * max(min(length, longest), self.least_move)
            self.F[free] += move
        return False

    def _fill(self, residual: np.ndarray) -> None:
        """Move the free components to where the packing bears something again.

        Grains that have lost their contacts do not tell how far apart they are: half the way back
        to a trial that bore something; without one, by the stiffness committed, then twice that.
        """
        free = self.condition.free
        if self._bearing is not None:
            self.F[free] = 0.5 * (self.F[free] + self._bearing)
            return
        if self._filling is None:
            self.law.discard()
            self._filling = -rounded(np.linalg.lstsq(self._stiffness(), residual, rcond=None)[0])
        self.F[free] += self._filling
        self._filling *= 2.0

    def _bracketed(self, residual: float) -> bool:
        """Whether the one free component has been moved into the bracket that there is."""
        here = float(self.F[self.condition.free][0]), residual
        if residual < 0:
            self._below = here
        else:
            self._above = here
        if self._below is None or self._above is None:
            return False
        (a, low), (b, high) = self._below, self._above
        self.jump = abs(b - a) < JUMP * self.least_move
        share = 0.5 if self.evaluations % 2 == 0 else -low / (high - low)
        self.F[self.condition.free] = a + share * (b - a)
        return True

    def _residual(self) -> np.ndarray:
        """(m,) Pa at the F of this moment."""
        self.evaluations += 1
        self.stress = self.law.evaluate(product(self.F, self.inverse)[None])[0]
        return self.condition.excess(self.stress)

    @staticmethod
    def _measured(
        jacobian: np.ndarray, first: np.ndarray, move: np.ndarray, seen: np.ndarray, scattered: bool
    ) -> np.ndarray:
        """The stiffness (m, m), Pa, after a move (m,) whose residual changed by `seen` (m,), Pa.

        Broyden's rank-one update. Where an answer has been worse than the one before, grains
        scatter, and so would secants: then the first stiffness, as much softer as was seen.
        """
        if not scattered or len(move) == 1:
            return jacobian + np.outer(seen - jacobian @ move, move / (move @ move))
        expected = first @ move
        share = (expected @ seen) / (expected @ expected)
        return first * np.clip(share, SOFTEST, 1.0)

    def _stiffness(self) -> np.ndarray:
        """d residual / d F (m, m), Pa, by the law's tangent at this trial."""
        by_F = np.einsum("ijkl,bl->ijkb", self.law.tangent()[0], self.inverse)
        return np.einsum("mij,ijkl->mkl", self.condition.rows, by_F)[:, self.condition.free]


def increment(
    law, F: np.ndarray, controlled: np.ndarray, target: np.ndarray, tolerance: float, most: int = 40
) -> tuple[np.ndarray, ElementState]:
    """One increment of law number 0 under mixed control; committed.

    Args:
        law: of size 1.
        F: (d, d) relative to the state; the first guess in the controlled components.
        controlled: (d, d) bool, where stress is prescribed and F free.
        target: (d, d) Pa, the stress there.
        tolerance: on the stress, Pa.
        most: evaluations at most.

    Returns the F found and the state (whose deformation is that of this increment).
    Raises RuntimeError where the stress is not reached; nothing is committed then.
    """
    condition = StressCondition.components(controlled, target)
    search = _Search(law, F, condition, np.eye(len(F)))
    if search.run(tolerance, most):
        law.commit()
        return search.F, ElementState(search.F, search.stress, search.evaluations, search.best)
    law.discard()
    raise RuntimeError(
        f"element test: stress off by {search.best:.3g} Pa after {search.evaluations} evaluations,"
        f" tolerance {tolerance:.3g} Pa"
    )


class Servo:
    """Leads law number 0 from one deformation to the next and keeps the account.

    Attributes:
        law: of size 1. deformation: (d, d), since the beginning, committed. stress: (d, d) Pa,
        committed. loose: increments so far that met the looser tolerance alone.
    """

    def __init__(self, law, tolerance: float, looser: float | None = None, most: int = 12):
        """The law at its beginning.

        Args:
            law: of size 1.
            tolerance: on prescribed stress, Pa.
            looser: accepted, Pa, where the stress jumps over its target: a packing that yields
                suddenly has no state in between. 100 times the tolerance by default. Where it does
                not jump but is not met either, `FAR` times the tolerance is accepted.
            most: evaluations of the law before an increment is cut.
        """
        self.law, self.deformation = law, np.eye(law.dim)
        self.stress = law.evaluate(self.deformation[None])[0]
        law.discard()
        self.tolerance, self.most = tolerance, most
        self.looser = 100 * tolerance if looser is None else looser
        self.loose = 0
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def shear(self) -> float:
        """gamma = F_1d so far."""
        return float(self.deformation[0, -1])

    @property
    def pressure(self) -> float:
        """Mean pressure, Pa, compression positive."""
        return -float(np.trace(self.stress)) / self.law.dim

    def to(self, F: np.ndarray, condition: StressCondition | None = None) -> ElementState:
        """One increment, to the total deformation F (d, d) where it is not free; committed.

        Raises NotReached where the stress cannot be met; the state is then the last one before.
        """
        condition = condition or StressCondition.none(self.law.dim)
        evaluations, error, reached = self._go(np.array(F, float), condition, 0)
        self.loose += not reached
        return ElementState(self.deformation.copy(), self.stress, evaluations, error, reached)

    def _go(self, F: np.ndarray, condition: StressCondition, cuts: int) -> tuple[int, float, bool]:
        start = self.deformation
        guess = F.copy()
        guess[condition.free] = start[condition.free]
        if cuts == 0:  # a guess that has led astray is not made again
            guess[condition.free] += self._predicted(F, condition)
        search = _Search(self.law, guess, condition, start, self.pressure)
        try:
            reached = search.run(self.tolerance, self.most, PATIENCE)
        except (ValueError, FloatingPointError):
            if cuts == MOST_CUTS:
                self.law.discard()
                raise
            reached = False
        close = search.jump or search.best <= CLOSE * self.tolerance
        if not reached and cuts < MOST_CUTS and not close:
            self.law.discard()
            return self._in_two(F, condition, cuts, search.evaluations)
        accepted = self.looser if search.jump else min(self.looser, FAR * self.tolerance)
        if not reached and search.best > accepted:
            self.law.discard()
            raise NotReached(
                f"element test: stress off by {search.best:.3g} Pa, tolerance {accepted:.3g} Pa,"
                f" after {search.evaluations} evaluations of an increment cut {cuts} times; the"
                " packing bears no more, or the increment is too large"
            )
        if not reached:
            self.stress = self.law.evaluate(product(search.best_F, search.inverse)[None])[0]
        else:
            self.stress = search.best_stress
        self.law.commit()
        self._last = np.where(condition.free, 0.0, F - start), search.best_F - start
        self.deformation = search.best_F
        return search.evaluations, search.best, reached

    def _in_two(
        self, F: np.ndarray, condition: StressCondition, cuts: int, evaluations: int
    ) -> tuple[int, float, bool]:
        """The same increment in two halves."""
        halfway = condition.values + 0.5 * condition.excess(self.stress)
        half = StressCondition(condition.free, condition.rows, halfway)
        first, _, _ = self._go(0.5 * (self.deformation + F), half, cuts + 1)
        second, error, reached = self._go(F, condition, cuts + 1)
        return evaluations + first + second, error, reached

    def _predicted(self, F: np.ndarray, condition: StressCondition) -> np.ndarray:
        """Change of the free components if they follow the prescribed ones as in the last step."""
        prescribed = np.where(condition.free, 0.0, F - self.deformation)
        if self._last is None:
            return np.zeros(condition.free.sum())
        squared = (self._last[0] ** 2).sum()
        share = (prescribed * self._last[0]).sum() / squared if squared > 0 else 0.0
        return np.clip(share, 0.0, 2.0) * self._last[1][condition.free]
