"""The answer of B packings to B deformation gradients, computed on the threads of this process."""

import warnings
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace

import numpy as np

from .accuracy import Accuracy
from .dynamics import OK, Workspace, workspace
from .homogenisation import Contacts, fabric, stress, touching
from .loading import Outcome, deform, logarithm, pressure_of, settings, shear_of
from .packing import PAIRS_PER_GRAIN, Packing, PackingBatch

#: A packing with more pairs than that per grain has collapsed.
MOST_PAIRS_PER_GRAIN = 40
#: Least volume of a box over that of its grains; below it they overlap beyond any contact law.
SOLID = 0.7


def warn_of_overlaps(contacts: Contacts, packing: Packing) -> None:
    """Warn of grains that overlap so much that contacts are none any more; too much is refused.

    Raises ValueError above half a diameter: such a packing was never at rest.
    """
    i, j = contacts.pairs.T
    overlap = float((contacts.overlaps / (packing.radii[i] + packing.radii[j])).max(initial=0.0))
    if overlap > 0.5:
        raise ValueError(
            f"grains overlap by up to {overlap:.0%} of their diameter: prepare the packing anew"
        )
    if overlap > 0.1:
        warnings.warn(
            f"grains overlap by up to {overlap:.0%} of their diameter: the contacts are too soft"
            " for this pressure",
            stacklevel=3,
        )


class Response:
    """B packings with a committed state and a trial state.

    `deform` always starts from the committed state, so that its result is a function of F alone;
    `commit` makes the trial the state. Results do not depend on the number of threads.

    Attributes:
        committed, trial: the two states. latest: the one of the two that was computed last.
        outcome: what was measured at `latest`. committed_outcome: the same at `committed`.
        pressure: (B,) Pa, of the committed state.
    """

    def __init__(self, packing: Packing, size: int, accuracy: Accuracy, threads: int = 1):
        """`size` copies of `packing`, at work around the packing's own pressure.

        Raises ValueError for a size or a number of threads that is not possible.
        """
        if threads < 1:
            raise ValueError(f"threads must be 1 or more, got {threads}")
        self.committed = PackingBatch.of(packing, size)
        self.trial = self.committed.copy()
        self.material = packing.material
        self.threads = threads
        self._spaces: deque[Workspace] = deque()
        self._scratch: deque[tuple[np.ndarray, ...]] = deque()
        self._capacity = PAIRS_PER_GRAIN[packing.dim] * packing.size
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        contacts = touching(packing)
        warn_of_overlaps(contacts, packing)
        initial = stress(packing, contacts)
        confining = max(float(pressure_of(initial)), 1e-6 * packing.contact_modulus)
        self.loading = settings(packing, accuracy, confining)
        self.committed_outcome = Outcome.of(size, packing.dim)
        self.committed_outcome.stress[:] = initial
        self.committed_outcome.fabric[:] = fabric(contacts)
        self.committed_outcome.contacts[:] = len(contacts.pairs)
        self.committed_outcome.at_rest[:] = True
        self._cost = np.zeros(size)
        self.discard()

    @property
    def size(self) -> int:
        """Number of packings."""
        return self.committed.size

    def deform(self, F: np.ndarray) -> Outcome:
        """Trial state at F (B, d, d) relative to the committed state; what was measured there.

        Raises ValueError for an F that is not a deformation (see `loading.logarithm`) or squeezes
        the box too far, and
        FloatingPointError for a packing that collapses.
        """
        self.outcome = self._run(F, np.arange(self.size), self.trial.state)
        self.latest = self.trial
        self._cost = self.outcome.loading_steps + self.outcome.hold_steps
        return self.outcome

    def probe(self, F: np.ndarray, packings: np.ndarray) -> Outcome:
        """What packings (n,) would answer to F (n, d, d); the trial state stays as it is."""
        return self._run(F, packings, None)

    def commit(self) -> None:
        """The trial state becomes the state; without a trial nothing changes."""
        if self.latest is self.trial:
            self.committed, self.trial = self.trial, self.committed
            self.committed.reduce_boxes()
            self.committed_outcome = self.outcome
        self.discard()

    def discard(self) -> None:
        """Forget the trial state: the latest state is the committed one again."""
        self.latest, self.outcome = self.committed, self.committed_outcome
        self.pressure = pressure_of(self.outcome.stress)

    def restore(self, state: dict[str, np.ndarray], outcome: Outcome) -> None:
        """Take over committed arrays of `PackingBatch.STATE`, and what was measured at them.

        Of any number of packings, which have the template's grains. The trial is forgotten.
        """
        self.committed = replace(self.committed, **state)
        self.trial = self.committed.copy()
        self.committed_outcome = outcome
        self._cost = outcome.loading_steps + outcome.hold_steps
        self.discard()

    def _run(self, F, packings, new) -> Outcome:
        F = np.ascontiguousarray(F, dtype=np.float64)
        log_F = logarithm(F)
        self._check_room(F @ self.committed.box[packings], packings)
        shear = shear_of(log_F)
        outcome = Outcome.of(len(packings), self.committed.template.dim)
        state = self.committed.state

        def one(row: int) -> None:
            b = packings[row]
            scratch = self._scratch_state() if new is None else None
            target, place = (scratch, 0) if new is None else (new, b)
            self.with_workspace(
                lambda work: deform(
                    b, F[row], log_F[row], shear[row], self.pressure[b], self.material,
                    self.loading, state, target, place, outcome, row, work,
                ),
                f"packing {b}",
            )  # fmt: skip
            if scratch is not None:
                self._scratch.append(scratch)

        expensive_first = np.argsort(-self._cost[packings], kind="stable")
        self.for_each(one, expensive_first)
        wrong = np.flatnonzero(~np.isfinite(outcome.stress).all((1, 2)))
        if len(wrong):
            raise FloatingPointError(
                f"packing {packings[wrong[0]]}: its stress is not finite; take smaller steps"
            )
        return outcome

    def _scratch_state(self) -> tuple[np.ndarray, ...]:
        """Arrays of a batch of one, for a state that nobody wants.

        Probing by the same compiled kernel as deforming gives the same bits.
        """
        try:
            return self._scratch.pop()
        except IndexError:
            return PackingBatch.of(self.committed.template, 1).state

    def _check_room(self, boxes: np.ndarray, packings: np.ndarray) -> None:
        """Raise ValueError for a box that its grains cannot fill sensibly."""
        template = self.committed.template
        inverse = np.linalg.inv(boxes)
        heights = 1.0 / np.linalg.norm(inverse, axis=2).max(1)
        volumes = np.linalg.det(boxes) * template.thickness
        low = np.flatnonzero(heights < 4.0 * template.radii.max())
        if len(low):
            raise ValueError(
                f"packing {packings[low[0]]}: its box is squeezed below two diameters of the"
                " largest grain, which would meet its own image; take more grains"
            )
        full = np.flatnonzero(volumes < SOLID * template.grain_volumes.sum())
        if len(full):
            raise ValueError(
                f"packing {packings[full[0]]}: its box is squeezed to"
                f" {volumes[full[0]] / template.grain_volumes.sum():.2f} of the grains' volume"
            )

    def for_each(self, task: Callable[[int], None], order: np.ndarray) -> None:
        """Run task(k) for every k of `order`, on all threads; the first error is raised."""
        if self._pool is None:
            for k in order:
                task(int(k))
            return
        running = [self._pool.submit(task, int(k)) for k in order]
        wait(running)  # all of them, also after an error: they write to shared arrays
        for future in running:
            future.result()

    def with_workspace(self, compute: Callable[[Workspace], int], name: str) -> None:
        """Call compute(work) with a work space that no other thread uses, a larger one if need be.

        Raises FloatingPointError where even a very large one does not do.
        """
        try:
            work = self._spaces.pop()
        except IndexError:
            work = self._new_workspace()
        while compute(work) != OK:
            capacity = 2 * work.pairs.i.size
            if capacity > MOST_PAIRS_PER_GRAIN * self.committed.template.size:
                raise FloatingPointError(
                    f"{name}: its grains have collapsed onto each other; take smaller steps, a"
                    " stiffer contact law or a smaller time step"
                )
            self._capacity = max(self._capacity, capacity)
            work = self._new_workspace()
        self._spaces.append(work)

    def _new_workspace(self) -> Workspace:
        viscous = self.material.viscosity is not None
        packing = self.committed.template
        return workspace(packing.size, packing.dim, self._capacity, viscous)
