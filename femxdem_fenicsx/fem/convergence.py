"""When a step is converged, and how a solve ended."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Convergence:
    """When a step is converged: each criterion that is given must hold.

    Attributes:
        force: FNORM/RNORM, the norm of the out-of-balance forces at the free dofs over that of
            the reactions at the constrained ones (Argilaga §2 and footnote 7).
        displacement: norm of the last correction over that of the step's displacement (Guo-Zhao
            eq. 21, who take 1e-2).
        max_iterations: give up after that many.

    Raises:
        ValueError: no criterion, or a limit that is not positive.
    """

    force: float | None = 1e-2
    displacement: float | None = None
    max_iterations: int = 20

    def __post_init__(self):
        limits = [limit for limit in (self.force, self.displacement) if limit is not None]
        if not limits or not all(limit > 0 for limit in limits) or self.max_iterations < 1:
            raise ValueError(
                f"convergence by force {self.force}, displacement {self.displacement} in "
                f"{self.max_iterations} iterations: give positive limits, one at least"
            )

    def holds(self, force: float, displacement: float) -> bool:
        """Whether these two ratios satisfy all criteria."""
        return (self.force is None or force <= self.force) and (
            self.displacement is None or displacement <= self.displacement
        )


@dataclass(frozen=True)
class Solution:
    """How a solve ended.

    Attributes:
        converged: whether all criteria hold at u.
        reason: PETSc's name for why it stopped, or the law's message.
        iterations: of SNES.
        evaluations: of the law, those for the first guess included.
        residual: FNORM/RNORM at u.
    """

    converged: bool
    reason: str
    iterations: int
    evaluations: int
    residual: float
