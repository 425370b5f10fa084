"""What one rank cannot do, no rank does: errors that all ranks raise together."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

from ..law import InadmissibleDeformation


def together(comm: MPI.Comm, action: Callable, *arguments):
    """Result of ``action(*arguments)``, called by all ranks; what fails on one raises on all.

    A rank that would go on alone waits for ever in the next collective call.

    Raises:
        InadmissibleDeformation: all failures are of this kind.
        Exception: the rank's own error, or a RuntimeError with the error of the first rank
            that failed.
    """
    result, error = None, None
    try:
        result = action(*arguments)
    except Exception as caught:
        error = caught
    if not comm.allreduce(error is not None, MPI.LOR):
        return result
    astray = error is None or isinstance(error, InadmissibleDeformation)
    astray = comm.allreduce(astray, MPI.LAND)
    messages = comm.allgather(None if error is None else f"{type(error).__name__}: {error}")
    rank, message = next((r, m) for r, m in enumerate(messages) if m is not None)
    if astray:
        raise InadmissibleDeformation(message.split(": ", 1)[1])
    if error is not None:
        raise error
    raise RuntimeError(f"on rank {rank}: {message}")
