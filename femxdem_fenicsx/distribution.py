"""Which rank computes which packing (Desrues section 3.2, with the packings staying at home).

In the papers a boss sends whole packings to whoever is idle. Here every packing lives on a home
rank, which need not be the rank of its quadrature point, and an evaluation moves nothing but F
there and the stress back. Between load steps packings change their homes where the steps that they
have taken promise that it pays.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple, Protocol

import h5py
import numpy as np
from mpi4py import MPI

from .collective import together
from .law import Law

#: What moving a packing costs, in steps of its DEM: docs/cluster.md has the measurement.
STEPS_PER_MOVE = 50
#: A placement stands while the busiest rank has at most this over the mean.
IMBALANCE_ALLOWED = 1.02


class MovableLaw(Law, Protocol):
    """A law whose points can move from one rank to another.

    Attributes:
        FIELDS: the attributes that are arrays with a value for each point.
        effort: steps that each point has taken so far, (n,), integers.
    """

    FIELDS: tuple[str, ...]
    effort: np.ndarray

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


def place(cost: np.ndarray, home: np.ndarray, ranks: int) -> np.ndarray:
    """New homes (n,): the longest first, each to the least loaded rank, or left where it is.

    Graham's longest processing time first gives the load that no rank should exceed; a packing
    that its present home can take within that load stays there.

    Args:
        cost: of each packing, (n,).
        home: rank where each is now, (n,).
        ranks: how many there are.
    """
    order = np.argsort(-cost, kind="stable")
    longest_first = _longest_first(cost, order, home, ranks, 0.0)
    limit = loads(cost, longest_first, ranks).max(initial=0.0)
    return _longest_first(cost, order, home, ranks, limit * (1 + 1e-12))


def _longest_first(cost, order, home, ranks: int, limit: float) -> np.ndarray:
    """Packings in `order` to the least loaded rank, or to their home if its load stays in limit."""
    load = np.zeros(ranks)
    heap = [(0.0, rank) for rank in range(ranks)]
    new = np.empty_like(home)
    for packing in order:
        rank = home[packing]
        if load[rank] + cost[packing] > limit:
            while heap[0][0] != load[heap[0][1]]:  # an old entry of a rank that has got more since
                heapq.heappop(heap)
            rank = heap[0][1]
        new[packing] = rank
        load[rank] += cost[packing]
        heapq.heappush(heap, (load[rank], rank))
    return new


class DistributedLaw:
    """A law whose points are computed on their home ranks. All its methods are collective.

    What else the law tells is found here as the attribute of the same name: a field, which comes
    from the homes, so that all ranks must ask for it; anything else is that of this rank's share.

    Attributes:
        law: the packings at home on this rank. dim: of the law.
        size: number of this rank's own quadrature points.
        numbers: of the points whose packings are at home here, in the law's order, ascending.
        balance: what the last commit found of the load, and did about it.
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
        self._effort = self.law.effort.copy()
        self._cost = None
        self.balance = self._found(np.ones(len(everyone)), self._home, self._home)

    def __getattr__(self, name: str):
        if name == "law":  # not made yet
            raise AttributeError(name)
        value = getattr(self.law, name)
        return self._to_points(value, "fields") if name in self.law.FIELDS else value

    # ---- the Law protocol -----------------------------------------------------------------------

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        """Stress (size, d, d), Pa, at F (size, d, d). Raises, on all ranks, what the law raises."""
        at_home = self._to_homes(np.asarray(F, np.float64), "evaluation")
        return self._to_points(together(self._comm, self.law.evaluate, at_home), "evaluation")

    def tangent(self) -> np.ndarray:
        """C = d sigma / d F (size, d, d, d, d), Pa, at the last trial."""
        return self._to_points(together(self._comm, self.law.tangent), "tangent")

    def commit(self) -> None:
        """The trial becomes the state; then packings change their homes where that pays."""
        together(self._comm, self.law.commit)
        self._rehome()

    def discard(self) -> None:
        """Forget the trial."""
        self.law.discard()

    def save(self, group: h5py.Group) -> None:
        """Write the committed state of the packings at home here, in the order of `numbers`."""
        self.law.save(group)

    def load(self, group: h5py.Group) -> None:
        """Read back what `save` wrote: rows in the order of `numbers`."""
        self.law.load(group)
        self._effort = self.law.effort.copy()

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

    def _rehome(self) -> None:
        """Move packings if the last load step's steps say that the next one gains by it."""
        cost = self._measured()
        self._effort = self.law.effort.copy()
        ranks = self._comm.size
        if imbalance(loads(cost, self._home, ranks)) <= IMBALANCE_ALLOWED:
            self.balance = self._found(cost, self._home, self._home)
            return
        new = place(cost, self._home, ranks)
        gain = loads(cost, self._home, ranks).max() - loads(cost, new, ranks).max()
        leaving = np.bincount(self._home[new != self._home], minlength=ranks)
        arriving = np.bincount(new[new != self._home], minlength=ranks)
        pays = gain > STEPS_PER_MOVE * max(leaving.max(), arriving.max())
        self.balance = self._found(cost, self._home, new if pays else self._home)
        if pays:
            self.move(new)

    def _measured(self) -> np.ndarray:
        """Steps of each packing since the last commit, (all points,), on all ranks."""
        spent = np.ascontiguousarray(self.law.effort - self._effort, np.int64)
        counts = np.bincount(self._home, minlength=self._comm.size)
        by_home = np.empty(len(self._home), np.int64)
        self._comm.Allgatherv(spent, [by_home, counts])
        cost = np.empty(len(self._home))
        cost[np.argsort(self._home, kind="stable")] = by_home
        return cost

    def _found(self, cost: np.ndarray, home: np.ndarray, new: np.ndarray) -> Balance:
        before, after = (imbalance(loads(cost, h, self._comm.size)) for h in (home, new))
        return Balance(before, after, int((home != new).sum()))

    def move(self, home: np.ndarray) -> None:
        """Give every packing a new home (all points,), the same on all ranks: bit for bit.

        Call it between load steps: a trial is forgotten.
        """
        old, numbers, rank = self._home, self.numbers, self._comm.rank
        arriving = np.flatnonzero(home == rank)
        leaves = np.argsort(home[numbers], kind="stable")
        to = np.bincount(home[numbers], minlength=self._comm.size)
        come = np.argsort(old[arriving], kind="stable")
        since = np.bincount(old[arriving], minlength=self._comm.size)
        state = self.law.state()
        for name in sorted(state):
            row = state[name][:0]
            arrived = np.empty((len(arriving), *row.shape[1:]), row.dtype)
            received = np.empty_like(arrived)
            leaving = np.ascontiguousarray(state[name][leaves])
            width = row.dtype.itemsize * int(np.prod(row.shape[1:]))
            self._comm.Alltoallv(_bytes(leaving, to * width), _bytes(received, since * width))
            arrived[come] = received
            state[name] = arrived
            self.sent["moves"] += int(to.sum() - to[rank]) * width
        self._settle(home)
        together(self._comm, self.law.restore, state)
        self._effort = self.law.effort.copy()

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


def imbalance(load: np.ndarray) -> float:
    """Load of the busiest rank over the mean of all; 1 where there is nothing to do."""
    return float(load.max() / load.mean()) if load.any() else 1.0


def _bytes(array: np.ndarray, counts: np.ndarray) -> list:
    """A contiguous array as MPI takes it, with so many bytes for each rank."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return [array.view(np.uint8) if array.size else array, counts, starts, MPI.BYTE]
