"""The answer of B packings to B deformation gradients, computed on the threads of this process."""

import math
import warnings
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace

import numpy as np

from .accuracy import Accuracy
from .dynamics import NO_ROOM, OK, TOO_MANY_CONTACTS, Material, Workspace, workspace
from .homogenisation import fabric, largest_overlap, stress, touching, unbalance_of
from .loading import (
    FEWEST_STEPS,
    Loading,
    Outcome,
    deform_in_turn,
    logarithm,
    pressure_of,
    settings,
    shear_of,
)
from .packing import PAIRS_PER_GRAIN, Packing, PackingBatch
from .reproducible import determinant, inverse, product
from .stability import vibration_of

#: A packing with more pairs than that per grain has collapsed.
MOST_PAIRS_PER_GRAIN = 40
#: Least volume of a box over that of its grains; below it they overlap beyond any contact law.
SOLID = 0.7
#: A law rounds strains to multiples of this, or less where grains are stiffer
#: (`strain_quantum_of`), before the grains see them. It is far below what they can resolve, and far
#: above the rounding of linear solvers, which the grains would amplify until 1 and 2 ranks, or two
#: kinds of CPU, part.
LARGEST_QUANTUM = 2.0**-30
#: What rounding a strain may change in the stress, over the pressure of the packing.
ROUNDED_AWAY = 1e-6
#: Every F is rounded to multiples of this, far below what a double tells beside 1: components that
#: are next to nothing would divide to infinity.
SMALLEST = 2.0**-60


def strain_quantum_of(packing: Packing, pressure: float) -> float:
    """A power of two: a strain of that size changes the stress by `ROUNDED_AWAY` of it at most.

    The stiffness is taken as that of a mean contact under `pressure` (Pa, positive) over the
    thickness or the mean radius, which no packing of such grains exceeds by much. Between
    `SMALLEST` and `LARGEST_QUANTUM`.
    """
    modulus = packing.contact_modulus(packing.overlap_under(pressure))
    share = ROUNDED_AWAY * pressure / modulus
    _, power = math.frexp(min(max(share, SMALLEST), LARGEST_QUANTUM))
    return math.ldexp(0.5, power)


def _multiples(x: np.ndarray, quantum: float) -> np.ndarray:
    """The nearest multiples of a power of two; exact."""
    return np.round(x / quantum) * quantum


def warn_of_overlaps(overlap: float) -> None:
    """Warn of grains that overlap so much that contacts are none any more; too much is refused.

    Raises ValueError above half a diameter: such a packing was never at rest.
    """
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
        friction: (B,) contact friction of each packing; None where it is the contact law's.
        outcome: what was measured at `latest`. committed_outcome: the same at `committed`.
        pressure: (B,) Pa, of the committed state. time_step: (B,) s, longest that is stable there.
        strain_quantum: laws round strains to multiples of it, see `strain_quantum_of`.
        commits: how often a trial became the state. held: (B,) steps of each packing's last hold.
    """

    def __init__(
        self,
        packing: Packing,
        size: int,
        accuracy: Accuracy,
        threads: int = 1,
        friction: np.ndarray | None = None,
    ):
        """`size` copies of `packing`, at work around the packing's own pressure.

        Raises ValueError for a size or a number of threads that is not possible, and for friction
        that is not positive.
        """
        if friction is not None:
            friction = np.broadcast_to(np.asarray(friction, dtype=np.float64), (size,)).copy()
            if packing.law.friction == 0 or not (friction > 0).all():
                raise ValueError("friction that varies must be positive, the contact law's too")
        self.friction = friction
        if threads < 1:
            raise ValueError(f"threads must be 1 or more, got {threads}")
        self.committed = PackingBatch.of(packing, size)
        self.trial = self.committed.copy()
        self.material = packing.material
        self.threads = threads
        self._spaces: deque[Workspace] = deque()
        self._scratch: deque[tuple[np.ndarray, ...]] = deque()
        self._capacity = PAIRS_PER_GRAIN[packing.dim] * packing.size
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None
        contacts = touching(packing)
        overlap = largest_overlap(contacts, packing)
        warn_of_overlaps(overlap)
        initial = stress(packing, contacts)
        confining = max(float(pressure_of(initial)), 1e-6 * packing.contact_modulus())
        self.loading = settings(packing, accuracy, confining)
        self.strain_quantum = strain_quantum_of(packing, confining)
        self.committed_outcome = Outcome.of(size, packing.dim)
        self.committed_outcome.stress[:] = initial
        self.committed_outcome.fabric[:] = fabric(contacts)
        self.committed_outcome.contacts[:] = len(contacts.pairs)
        self.committed_outcome.overlap[:] = overlap
        self.committed_outcome.unbalance[:] = unbalance = unbalance_of(contacts, packing)
        self.committed_outcome.at_rest[:] = unbalance < accuracy.tolerance
        # of the state that `loading.time_step` is for; without contacts, in its own terms
        self._first_vibration = vibration_of(packing, contacts, overlap)
        self._first_vibration = (
            self._first_vibration or (2.0 * accuracy.time_step / self.loading.time_step) ** 2
        )
        self.committed_outcome.vibration[:] = self._first_vibration
        self.commits = 0
        self.held = np.zeros(size, np.int64)
        self.discard()

    @property
    def size(self) -> int:
        """Number of packings."""
        return self.committed.size

    def deform(self, F: np.ndarray) -> Outcome:
        """Trial state at F (B, d, d) relative to the committed state; what was measured there.

        A packing that is at rest and asked for nothing, F = I, answers with its committed state: a
        hold would go on within the tolerance, and the stress creep by up to 0.5 % of the pressure
        (docs/stability.md).

        Raises ValueError for an F that is not a deformation (see `loading.logarithm`) or squeezes
        the box too far, and FloatingPointError for a packing that collapses.
        """
        F = np.ascontiguousarray(F, dtype=np.float64)
        still = self._stand_still(F)
        self.outcome = self._run(F, np.arange(self.size), self.trial.state, still=still)
        self.latest = self.trial
        for new, old in zip(self.trial.state, self.committed.state, strict=True):
            new[still] = old[still]
        for new, old in zip(self.outcome, self.committed_outcome, strict=True):
            new[still] = old[still]
        self.outcome.loading_steps[still] = self.outcome.hold_steps[still] = 0
        self.held = np.where(still, self.held, self.outcome.hold_steps)
        return self.outcome

    def rounded(self, F: np.ndarray) -> np.ndarray:
        """F (n, d, d) with F - I in multiples of `strain_quantum`, as laws give it to `deform`."""
        identity = np.eye(self.committed.template.dim)
        change = np.asarray(F, dtype=np.float64) - identity
        return identity + _multiples(change, self.strain_quantum)

    def _stand_still(self, F: np.ndarray) -> np.ndarray:
        """(B,) bool: at rest, and asked for nothing."""
        return (F == np.eye(self.committed.box.shape[-1])).all((1, 2)) & (
            self.committed_outcome.at_rest
        )

    def expected_steps(self, F: np.ndarray) -> np.ndarray:
        """Steps (B,) that `deform` will take at F (B, d, d): to load, exactly; to hold, as before.

        Raises ValueError for an F that is not a deformation.
        """
        steps = self._expected_steps(shear_of(logarithm(F)), np.arange(self.size), self.loading)
        return np.where(self._stand_still(F), 0, steps)

    def _expected_steps(self, shear, packings, loading: Loading) -> np.ndarray:
        pressure = np.maximum(self.pressure[packings], loading.least_pressure)
        speed = loading.inertial_number * np.sqrt(pressure / loading.density)
        duration = shear * loading.mean_diameter / speed  # tau of eq. 18
        stable = self.time_step[packings] / np.sqrt(1.0 + loading.damping)
        steps = np.ceil(duration / stable).astype(np.int64)
        return np.maximum(steps, FEWEST_STEPS) + self.held[packings]

    def probe(
        self,
        F: np.ndarray,
        packings: np.ndarray,
        start: PackingBatch | None = None,
        material: Material | None = None,
        loading: Loading | None = None,
        end: PackingBatch | None = None,
    ) -> Outcome:
        """What packings (n,) would answer to F (n, d, d); the trial state stays as it is.

        From the committed state and as `deform` would, unless told otherwise. `end` takes the
        states, each packing's in its own row.
        """
        new = None if end is None else end.state
        return self._run(F, packings, new, start, material, loading)

    def commit(self) -> None:
        """The trial state becomes the state; without a trial nothing changes."""
        if self.latest is self.trial:
            self.committed, self.trial = self.trial, self.committed
            self.committed.reduce_boxes()
            self.committed_outcome = self.outcome
            self.commits += 1
        self.discard()

    def discard(self) -> None:
        """Forget the trial state: the latest state is the committed one again."""
        self.latest, self.outcome = self.committed, self.committed_outcome
        self.pressure = pressure_of(self.outcome.stress)
        # shorter where contacts have formed or stiffened since the beginning
        growth = np.maximum(self.outcome.vibration / self._first_vibration, 1.0)
        self.time_step = self.loading.time_step / np.sqrt(growth)

    def restore(self, state: dict[str, np.ndarray], outcome: Outcome, held: np.ndarray) -> None:
        """Take over committed arrays of `PackingBatch.STATE`, what was measured, and the holds.

        Of any number of packings, which have the template's grains. The trial is forgotten.
        """
        room = {name: np.empty_like(array) for name, array in state.items()}
        self.committed, self.trial = (replace(self.committed, **s) for s in (state, room))
        self.committed_outcome, self.held = outcome, held
        self.discard()

    def _run(
        self, F, packings, new, start=None, material=None, loading=None, still=False
    ) -> Outcome:
        """What `packings` answer to F; those that stand `still` are left out."""
        start = start or self.committed
        material, loading = material or self.material, loading or self.loading
        F = _multiples(np.ascontiguousarray(F, dtype=np.float64), SMALLEST)
        log_F = logarithm(F)
        self._check_room(product(F, start.box[packings]), packings)
        shear = shear_of(log_F)
        outcome = Outcome.of(len(packings), self.committed.template.dim)
        places = np.zeros_like(packings) if new is None else packings
        status = np.full(len(packings), NO_ROOM)
        expected = self._expected_steps(shear, packings, loading)
        expensive_first = np.argsort(-expected, kind="stable")
        moving = ~np.broadcast_to(still, expensive_first.shape)[expensive_first]
        for chosen, waiting in self._materials(material, packings, expensive_first[moving]):
            self._run_rows(
                waiting, packings, places, F, log_F, shear, chosen, loading, start, new, outcome,
                status,
            )  # fmt: skip
        wrong = np.flatnonzero(~np.isfinite(outcome.stress).all((1, 2)))
        if len(wrong):
            raise FloatingPointError(
                f"packing {packings[wrong[0]]}: its stress is not finite; take smaller steps"
            )
        return outcome

    def _materials(self, material: Material, packings: np.ndarray, rows: np.ndarray):
        """(material, rows of that material): one each for packings of the same friction."""
        if self.friction is None or material.friction != self.material.friction:
            return [(material, rows)]
        of_row = self.friction[packings[rows]]
        return [
            (material._replace(friction=float(friction)), rows[of_row == friction])
            for friction in np.unique(of_row)
        ]

    def _run_rows(
        self, waiting, packings, places, F, log_F, shear, material, loading, start, new, outcome,
        status,
    ) -> None:  # fmt: skip
        """Deform the rows `waiting` of `packings`, all of one material, on all threads."""
        while len(waiting):
            tickets = np.zeros(1, np.int64)

            def work(waiting=waiting, tickets=tickets) -> None:
                space, target = self._take_workspace(), self._take_state() if new is None else new
                deform_in_turn(
                    tickets, waiting, packings, places, F, log_F, shear, self.pressure,
                    self.time_step, material, loading, start.state, target,
                    outcome, status, space,
                )  # fmt: skip
                self._spaces.append(space)
                if new is None:
                    self._scratch.append(target)

            self._on_threads(work, len(waiting))
            self._check_contacts(packings[status == TOO_MANY_CONTACTS])
            waiting = waiting[status[waiting] != OK]
            if len(waiting):
                self._make_more_room(f"packing {packings[waiting].min()}", 2 * self._capacity)

    def _check_contacts(self, overfull: np.ndarray) -> None:
        """Raise FloatingPointError for packings with more contacts than a batch has room for."""
        if len(overfull):
            room = self.committed.second.shape[1] / self.committed.template.size
            raise FloatingPointError(
                f"packing {overfull.min()}: more than {room:.1f} contacts per grain; its contacts"
                " are too soft for this pressure, take stiffer ones"
            )

    def _take_state(self) -> tuple[np.ndarray, ...]:
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
        heights = 1.0 / np.linalg.norm(inverse(boxes), axis=2).max(1)
        volumes = determinant(boxes) * template.thickness
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
        """Run task(k) for every k of `order`, on all threads.

        All are run, also after an error: they write to shared arrays. Then the error of the first
        one in `order` is raised.
        """
        waiting = deque(enumerate(order.tolist()))
        errors: list[tuple[int, Exception]] = []

        def work() -> None:
            while waiting:
                try:
                    place, k = waiting.popleft()
                except IndexError:  # another thread took the last one
                    return
                try:
                    task(k)
                except Exception as error:
                    errors.append((place, error))

        self._on_threads(work, len(order))
        if errors:
            raise min(errors, key=lambda pair: pair[0])[1]

    def _on_threads(self, work: Callable[[], None], most: int) -> None:
        """Call work() on this thread and on the others, on at most so many in all."""
        helpers = [self._pool.submit(work) for _ in range(min(self.threads, most) - 1)]
        try:
            work()
        finally:
            wait(helpers)
        for helper in helpers:
            helper.result()

    def with_workspace(self, compute: Callable[[Workspace], int], name: str) -> None:
        """Call compute(work) with a work space that no other thread uses, a larger one if need be.

        Raises FloatingPointError where even a very large one does not do.
        """
        work = self._take_workspace()
        while compute(work) != OK:
            self._make_more_room(name, 2 * work.pairs.i.size)
            work = self._take_workspace()
        self._spaces.append(work)

    def _take_workspace(self) -> Workspace:
        """One with room for `_capacity` pairs that no other thread uses."""
        while self._spaces:
            try:
                work = self._spaces.pop()
            except IndexError:  # another thread took the last one
                break
            if work.pairs.i.size >= self._capacity:
                return work
        viscous = self.material.viscosity is not None
        packing = self.committed.template
        memory = self.committed.memory.shape[1]
        return workspace(packing.size, packing.dim, self._capacity, viscous, memory)

    def _make_more_room(self, name: str, capacity: int) -> None:
        if capacity > MOST_PAIRS_PER_GRAIN * self.committed.template.size:
            raise FloatingPointError(
                f"{name}: its grains have collapsed onto each other; take smaller steps, a"
                " stiffer contact law or a smaller time step"
            )
        self._capacity = max(self._capacity, capacity)
