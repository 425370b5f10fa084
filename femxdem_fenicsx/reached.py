"""What the micro scale reached in a run, beside what its accuracy settings asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .dem.loading import Loading

#: Share of evaluations that may end at the limit of their hold.
HOLDS_ALLOWED = 0.01
#: Times the inertial number asked for: as much as a pressure that falls in an increment makes it.
FASTER_ALLOWED = 3.0
#: Overlap of two grains over their mean diameter up to which they are grains in contact.
OVERLAP_ALLOWED = 0.1


def _one(value):
    return value


@dataclass(frozen=True)
class Reached:
    """The worst of all evaluations of all packings in a run.

    Attributes:
        holds_at_limit: share of the evaluations that did not come to rest within the hold limit.
        unbalance: largest net force on a grain over the largest contact force (Desrues eq. 19).
        inertial_number: largest of Desrues eq. 18, with the pressure that there was.
        overlap: of a contact, over the mean diameter of its grains.
        asked: the settings.
    """

    holds_at_limit: float
    unbalance: float
    inertial_number: float
    overlap: float
    asked: Loading

    @classmethod
    def by(cls, law, total: Callable = _one, most: Callable[[float], float] = _one) -> Reached:
        """By a law with a `Tally`. total, most: sum and largest over the ranks, where there are."""
        tally = law.tally
        return cls(
            total(tally.unfinished) / max(total(tally.packings), 1),
            most(tally.worst_unbalance),
            most(tally.largest_inertial_number),
            most(tally.worst_overlap),
            law.response.loading,
        )

    @property
    def table(self) -> dict[str, str]:
        """Rows of the table at the end of a run."""
        return {
            "holds that ended at their limit": f"{self.holds_at_limit:.1%}",
            "worst unbalance, largest overlap": f"{self.unbalance:.1e}, {self.overlap:.1e}",
            "largest inertial number": f"{self.inertial_number:.1e}",
        }

    @property
    def warning(self) -> str:
        """One line where a run was less accurate than its settings promise; empty otherwise."""
        found = []
        if self.holds_at_limit > HOLDS_ALLOWED:
            found.append(
                f"{self.holds_at_limit:.1%} of the holds ended at their limit of"
                f" {self.asked.hold_limit} steps, with an unbalance of up to {self.unbalance:.1e}"
            )
        if self.inertial_number > FASTER_ALLOWED * self.asked.inertial_number:
            found.append(
                f"an inertial number of {self.inertial_number:.1e} was reached where"
                f" {self.asked.inertial_number:.1e} was asked for: packings lost their pressure"
            )
        if self.overlap > OVERLAP_ALLOWED:
            found.append(
                f"grains overlapped by up to {self.overlap:.0%} of their diameter: the contacts"
                " are too soft"
            )
        return f"warning: less accurate than asked for: {'; '.join(found)}" if found else ""
