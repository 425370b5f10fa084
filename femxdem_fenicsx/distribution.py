"""Which rank computes which packing (Desrues section 3.2, with the packings staying at home).

In the papers a boss sends whole packings to whoever is idle. Here every packing lives on a home
rank, which need not be the rank of its quadrature point, and an evaluation moves nothing but F
there and the stress back. An evaluation starts from the committed state, so before any of them
packings can change their homes: they do where the steps that they are about to take promise that
it pays. Those of the loading follow from F; those of the hold are guessed from the last one.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple, Protocol

import h5py
import numpy as np
from mpi4py import MPI
from numba import njit

from .collective import together
from .law import Law

#: Steps of a packing's DEM that take as long as a change of homes, beside what it takes for each
#: packing: sending it to another rank, or copying one that stays into new arrays, which is done
#: where the rank's packings change (docs/cluster.md).
STEPS_PER_CHANGE, STEPS_PER_MOVE, STEPS_PER_STAY = 60.0, 3.0, 2.0
#: Evaluations within which a change must pay: the next ones are not much like this one.
EVALUATIONS_TO_PAY = 2
#: A placement stands while the busiest rank has at most this over the mean.
IMBALANCE_ALLOWED = 1.02


class MovableLaw(Law, Protocol):
    """A law whose points can move from one rank to another.

    Attributes:
        FIELDS: the attributes that are arrays with a value for each point.
        threads: that share the points of a rank.
    """

    FIELDS: tuple[str, ...]
    threads: int

    def expected_cost(self, F: np.ndarray) -> np.ndarray:
        """Steps that each point is likely to take at F (n, d, d), (n,), integers."""
        ...

    def state(self) -> dict[str, np.ndarray]:
        """The committed state: arrays with one row per point."""
        ...

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Take over what `state` gave, of any number of points, which becomes `size`."""
        ...


class Balance(NamedTuple):
    """Load of the busiest rank over the mean, at the homes before and after; packings moved."""

    before: float
    after: float
    moved: int


def loads(cost: np.ndarray, home: np.ndarray, ranks: int) -> np.ndarray:
    """Sum of the costs (n,) at each rank, (ranks,)."""
    return np.bincount(home, weights=cost, minlength=ranks)


def place(cost: np.ndarray, home: np.ndarray, ranks: int, threads: int = 1) -> np.ndarray:
    """New homes (n,): the longest first, each to the least loaded thread, or left where it is.

    Graham's longest processing time first gives the load that no thread should exceed; a packing
    that its present home can take within that load stays there.

    Args:
        cost: of each packing, (n,).
        home: rank where each is now, (n,).
        ranks: how many there are.
        threads: that share the packings of a rank.
    """
    return _place(cost, home, ranks, threads)[0]


def _place(cost, home, ranks: int, threads: int) -> tuple[np.ndarray, float]:
    """New homes, and the load of the busiest thread there."""
    cost, order = np.asarray(cost, np.float64), np.argsort(-cost, kind="stable")
    _, limit = _longest_first(cost, order, home, ranks, threads, 0.0)
    return _longest_first(cost, order, home, ranks, threads, limit * (1 + 1e-12))


@njit(cache=True)
def _longest_first(cost, order, home, ranks, threads, limit):
    """Packings in `order` to the least loaded thread, or to one at home if its load is in limit."""
    load = np.zeros((ranks, threads))  # each row is a heap
    heap = [(0.0, rank) for rank in range(ranks)]
    new = np.empty_like(home)
    for packing in order:
        rank = home[packing]
        if load[rank, 0] + cost[packing] > limit:
            while heap[0][0] != load[heap[0][1], 0]:  # an old entry: the rank has got more since
                heapq.heappop(heap)
            rank = heap[0][1]
        new[packing] = rank
        _add(load[rank], cost[packing])
        heapq.heappush(heap, (load[rank, 0], rank))
    return new, load.max()


@njit(cache=True)
def _add(heap, cost):
    """Add to the least entry of a heap."""
    heap[0] += cost
    at = 0
    while True:
        least = at
        for child in (2 * at + 1, 2 * at + 2):
            if child < len(heap) and heap[child] < heap[least]:
                least = child
        if least == at:
            return
        heap[at], heap[least] = heap[least], heap[at]
        at = least


def busiest(cost: np.ndarray, home: np.ndarray, ranks: int, threads: int) -> float:
    """Load of the busiest thread, if those of a rank take its packings the longest first."""
    cost, order = np.asarray(cost, np.float64), np.argsort(-cost, kind="stable")
    return _longest_first(cost, order, home, ranks, threads, np.inf)[1]


def better_homes(cost: np.ndarray, home: np.ndarray, ranks: int, threads: int) -> np.ndarray | None:
    """New homes (n,), where two evaluations gain more by them than the change takes; else None.

    Arguments as those of `place`.
    """
    if imbalance(loads(cost, home, ranks)) <= IMBALANCE_ALLOWED:
        return None
    new, after = _place(cost, home, ranks, threads)
    gain = busiest(cost, home, ranks, threads) - after
    return new if EVALUATIONS_TO_PAY * gain > price_of(home, new, ranks) else None


def price_of(home: np.ndarray, new: np.ndarray, ranks: int) -> float:
    """Steps that packings could take while they change their homes, at the slowest rank."""
    leave, arrive = (np.bincount(h[new != home], minlength=ranks) for h in (home, new))
    most = np.maximum(leave, arrive)
    stay = np.where(most > 0, np.bincount(home[new == home], minlength=ranks), 0)
    return STEPS_PER_CHANGE + float((STEPS_PER_MOVE * most + STEPS_PER_STAY * stay).max())


def imbalance(load: np.ndarray) -> float:
    """Load of the busiest rank over the mean of all; 1 where there is nothing to do."""
    return float(load.max() / load.mean()) if load.any() else 1.0


class DistributedLaw:
    """A law whose points are computed on their home ranks. All its methods are collective.

    What else the law tells is found here as the attribute of the same name: a field, which comes
    from the homes, so that all ranks must ask for it; anything else is that of this rank's share.

    Attributes:
        law: the packings at home on this rank. dim: of the law.
        size: number of this rank's own quadrature points.
        numbers: of the points whose packings are at home here, in the law's order, ascending.
        balance: what the last evaluation found of the load, and did about it. moved: packings that
            have changed their homes so far.
        sent: bytes that this rank has sent to others, by purpose.

    Args:
        comm: ranks of the mesh.
        points: numbers of this rank's quadrature points in the whole mesh, (size,). The ranks
            together have each number from 0 on once.
        make: the law of the packings with the given numbers (n,).

    Raises:
        ValueError: numbers that are missing or twice, on all ranks.
    """

    def __init__(
        self, comm: MPI.Comm, points: np.ndarray, make: Callable[[np.ndarray], MovableLaw]
    ):
        self._comm, self._points = comm, np.asarray(points, np.int64)
        self.size = len(self._points)
        ranks = np.repeat(np.arange(comm.size), comm.allgather(self.size))
        everyone = np.concatenate(comm.allgather(self._points))
        if not np.array_equal(np.sort(everyone), np.arange(len(everyone))):
            raise ValueError("the quadrature points are not numbered from 0 on, each of them once")
        self._owner = np.empty(len(everyone), np.int64)
        self._owner[everyone] = ranks
        self._graph = None
        self.sent: Counter[str] = Counter()
        self._settle(place(np.ones(len(everyone)), self._owner, comm.size))
        self.law = together(comm, make, self.numbers)
        self.dim = self.law.dim
        self._threads = comm.allreduce(self.law.threads, MPI.MIN)  # all must decide the same
        self.balance, self.moved = Balance(1.0, 1.0, 0), 0

    def __getattr__(self, name: str):
        if name == "law":  # not made yet
            raise AttributeError(name)
        value = getattr(self.law, name)
        return self._to_points(value, "fields") if name in self.law.FIELDS else value

    # ---- the Law protocol -----------------------------------------------------------------------

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        """Stress (size, d, d), Pa, at F (size, d, d). Raises, on all ranks, what the law raises."""
        F = np.asarray(F, np.float64)
        at_home = self._to_homes(F, "evaluation")
        if self._rehome(together(self._comm, self.law.expected_cost, at_home)):
            at_home = self._to_homes(F, "evaluation")
        return self._to_points(together(self._comm, self.law.evaluate, at_home), "evaluation")

    def tangent(self) -> np.ndarray:
        """C = d sigma / d F (size, d, d, d, d), Pa, at the last trial."""
        return self._to_points(together(self._comm, self.law.tangent), "tangent")

    def commit(self) -> None:
        """The trial becomes the state."""
        together(self._comm, self.law.commit)

    def discard(self) -> None:
        """Forget the trial."""
        self.law.discard()

    def save(self, group: h5py.Group) -> None:
        """Write the committed state of the packings at home here, in the order of `numbers`."""
        self.law.save(group)

    def load(self, group: h5py.Group) -> None:
        """Read back what `save` wrote: rows in the order of `numbers`."""
        self.law.load(group)

    def packing(self, point: int | None):
        """The committed packing of one point, on all ranks; `point` on the rank that asks alone."""
        asked = self._comm.allgather(None if point is None else int(self._points[point]))
        number = next((n for n in asked if n is not None), None)
        if number is None:
            return None
        home = int(self._home[number])
        at_home = int(np.searchsorted(self.numbers, number))
        packing = self.law.packing(at_home) if self._comm.rank == home else None
        return self._comm.bcast(packing, root=home)

    # ---- moving house ---------------------------------------------------------------------------

    def _rehome(self, expected: np.ndarray) -> bool:
        """Move packings if their expected costs (n,) say that this evaluation gains by it."""
        ranks, new = self._comm.size, None
        load = np.empty(ranks, np.int64)
        self._comm.Allgather(np.array([expected.sum()], np.int64), load)
        busy = imbalance(load)
        if busy > IMBALANCE_ALLOWED:
            cost = self._everywhere(expected)
            new = better_homes(cost, self._home, ranks, self._threads)
        if new is None:
            self.balance = Balance(busy, busy, 0)
            return False
        moved = int((new != self._home).sum())
        self.balance = Balance(busy, imbalance(loads(cost, new, ranks)), moved)
        self.moved += moved
        self.move(new)
        return True

    def _everywhere(self, at_home: np.ndarray) -> np.ndarray:
        """Integers of the packings at home here -> those of all packings, on all ranks."""
        counts = np.bincount(self._home, minlength=self._comm.size)
        by_home = np.empty(len(self._home), np.int64)
        self._comm.Allgatherv(np.ascontiguousarray(at_home, np.int64), [by_home, counts])
        values = np.empty(len(self._home))
        values[np.argsort(self._home, kind="stable")] = by_home
        return values

    def move(self, home: np.ndarray) -> None:
        """Give every packing a new home (all points,), the same on all ranks: bit for bit.

        A trial is forgotten.
        """
        old, here, rank, ranks = self._home, self.numbers, self._comm.rank, self._comm.size
        there = np.flatnonzero(home == rank)
        leaving = here[home[here] != rank]
        leaving = leaving[np.argsort(home[leaving], kind="stable")]
        arriving = there[old[there] != rank]
        arriving = arriving[np.argsort(old[arriving], kind="stable")]
        staying = there[old[there] == rank]
        to, since = (np.bincount(ends, minlength=ranks) for ends in (home[leaving], old[arriving]))
        state = self.law.state()
        sent = _packed({name: rows[np.searchsorted(here, leaving)] for name, rows in state.items()})
        received = np.empty((len(arriving), sent.shape[1]), np.uint8)
        width = sent.shape[1]
        self._comm.Alltoallv(_bytes(sent, to * width), _bytes(received, since * width))
        self.sent["moves"] += sent.nbytes
        self._settle(home)
        if len(leaving) + len(arriving) == 0:
            together(self._comm, self.law.discard)
            return
        stays = np.searchsorted(here, staying)
        place = np.argsort(np.concatenate([staying, arriving]))
        for name, new in _unpacked(received, state).items():
            state[name] = np.concatenate([state[name][stays], new])[place]
        together(self._comm, self.law.restore, state)

    def _settle(self, home: np.ndarray) -> None:
        """Work out who sends how many points to whom when every packing is at its home."""
        rank, ranks = self._comm.rank, self._comm.size
        self._home, self.numbers = home, np.flatnonzero(home == rank)
        there, here = home[self._points], self._owner[self.numbers]
        self._leaves, self._comes = (
            np.lexsort((self._points, there)),
            np.argsort(here, kind="stable"),
        )
        away, back = np.bincount(there, minlength=ranks), np.bincount(here, minlength=ranks)
        neighbours = np.flatnonzero((away + back > 0) | (np.arange(ranks) == rank))
        self._away, self._back = away[neighbours], back[neighbours]
        self._elsewhere = neighbours != rank
        if self._graph is not None:
            self._graph.Free()
        self._graph = self._comm.Create_dist_graph_adjacent(neighbours, neighbours)

    # ---- exchange -------------------------------------------------------------------------------

    def _to_homes(self, values: np.ndarray, purpose: str) -> np.ndarray:
        """Values at this rank's points -> values at the packings at home here."""
        return self._exchange(values, self._leaves, self._away, self._comes, self._back, purpose)

    def _to_points(self, values: np.ndarray, purpose: str) -> np.ndarray:
        """Values at the packings at home here -> values at this rank's points."""
        return self._exchange(values, self._comes, self._back, self._leaves, self._away, purpose)

    def _exchange(self, values, leaves, away, comes, back, purpose: str) -> np.ndarray:
        """Send rows `leaves` to the neighbours, `away` of them to each; receive `comes`."""
        leaving = np.ascontiguousarray(values[leaves])
        arriving = np.empty((len(comes), *values.shape[1:]), values.dtype)
        width = values.dtype.itemsize * int(np.prod(values.shape[1:]))
        self._graph.Neighbor_alltoallv(
            _bytes(leaving, away * width), _bytes(arriving, back * width)
        )
        self.sent[purpose] += int(away[self._elsewhere].sum()) * width
        result = np.empty_like(arriving)
        result[comes] = arriving
        return result


def _packed(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Arrays with n rows -> the bytes of each row, one array after the other, (n, bytes)."""
    columns = [_flat(arrays[name]).view(np.uint8) for name in _with_content(arrays)]
    return np.ascontiguousarray(np.concatenate(columns, axis=1))


def _unpacked(rows: np.ndarray, like: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What `_packed` has packed: arrays as those of `like`, but with other rows."""
    found, start = {}, 0
    for name, array in like.items():
        found[name] = np.empty((len(rows), *array.shape[1:]), array.dtype)
    for name in _with_content(like):
        bytes_ = _flat(found[name]).view(np.uint8)
        bytes_[:] = rows[:, start : start + bytes_.shape[1]]
        start += bytes_.shape[1]
    return found


def _with_content(arrays: dict[str, np.ndarray]) -> list[str]:
    return [name for name in sorted(arrays) if math.prod(arrays[name].shape[1:]) > 0]


def _flat(array: np.ndarray) -> np.ndarray:
    """As (n, values of a row): a view where the array is contiguous."""
    return np.ascontiguousarray(array).reshape(len(array), math.prod(array.shape[1:]))


def _bytes(array: np.ndarray, counts: np.ndarray) -> list:
    """A contiguous array as MPI takes it, with so many bytes for each rank."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return [array.view(np.uint8) if array.size else array, counts, starts, MPI.BYTE]
