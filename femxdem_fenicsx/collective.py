"""What one rank cannot do, no rank does: errors that all ranks raise together."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

from .law import InadmissibleDeformation


class Interrupted(Exception):
    """The run was asked to stop: what was solved for is given up, the committed state stands."""


#: Errors that reach all ranks as what they are, the more urgent one first.
SHARED = (Interrupted, InadmissibleDeformation)


def together(comm: MPI.Comm, action: Callable, *arguments):
    """Result of ``action(*arguments)``, called by all ranks; what fails on one raises on all.

    A rank that would go on alone waits for ever in the next collective call.

    Raises:
        Interrupted, InadmissibleDeformation: all failures are of these kinds.
        Exception: the rank's own error, or a RuntimeError with the error of the first rank
            that failed.
    """
    if comm.size == 1:
        return action(*arguments)
    result, error = None, None
    try:
        result = action(*arguments)
    except Exception as caught:
        error = caught
    if not comm.allreduce(error is not None, MPI.LOR):
        return result
    own = None if error is None else (_urgency(error), type(error).__name__, str(error))
    failures = [(rank, *told) for rank, told in enumerate(comm.allgather(own)) if told]
    real = [failure for failure in failures if failure[1] == len(SHARED)]
    if not real:
        _, urgency, _, message = min(failures, key=lambda failure: failure[1])
        raise SHARED[urgency](message)
    if error is not None and own[0] == len(SHARED):
        raise error
    rank, _, name, message = real[0]
    raise RuntimeError(f"on rank {rank}: {name}: {message}")


def _urgency(error: Exception) -> int:
    """Place of the error's kind in `SHARED`; behind the last one for all others."""
    kinds = [k for k, kind in enumerate(SHARED) if isinstance(error, kind)]
    return kinds[0] if kinds else len(SHARED)
