"""What a demo needs around its scene: arguments, threads, one-line errors, progress, a table."""

from __future__ import annotations

import argparse
import os
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout

from mpi4py import MPI

from . import terminal
from .fem.options import petsc_options
from .terminal import LOST_CONTROLLABILITY, USER_ERROR, USER_ERRORS, HelpFormatter, refuse

__all__ = ["LOST_CONTROLLABILITY", "USER_ERROR", "USER_ERRORS", "HelpFormatter"]

#: Exit code of a run that a signal stopped, less the signal's number: the shell's convention.
SIGNALLED = 128
#: s; ranks that fail together do so within this time.
TOGETHER = 10.0


def run(main: Callable[[MPI.Comm], int], comm: MPI.Comm = MPI.COMM_WORLD) -> None:
    """Exit with what main(comm) returns; a user's mistake is one line and exit code 2.

    Errors must reach all ranks (see `collective.together`); then rank 0 alone prints. One that
    does not ends all ranks, so that none waits for ever.
    """
    watch = comm.Dup()
    try:
        code = main(comm)
    except Exception as error:
        code = _fail(comm, watch, error)
    sys.stdout.flush()
    sys.exit(code)


def _fail(comm: MPI.Comm, watch: MPI.Comm, error: Exception) -> int:
    """Say what went wrong, once; the exit code."""
    everywhere = _all_arrive(watch)
    elsewhere = isinstance(error, RuntimeError) and str(error).startswith("on rank ")
    known = elsewhere or isinstance(error, USER_ERRORS)
    if comm.rank == 0 or not everywhere:
        if known:
            where = "" if everywhere else f"on rank {comm.rank}: "
            print(f"error: {where}{error}", file=sys.stderr, flush=True)
        else:
            traceback.print_exception(error)
            sys.stderr.flush()
    if not everywhere:
        comm.Abort(USER_ERROR if known else 1)
    return USER_ERROR if known else 1


def _all_arrive(watch: MPI.Comm) -> bool:
    """Whether all ranks come here, soon; `watch` is used for nothing else."""
    arrived, since = watch.Ibarrier(), time.monotonic()
    while not arrived.Test():
        if time.monotonic() - since > TOGETHER:
            return False
        time.sleep(0.01)
    return True


def parse(parser: argparse.ArgumentParser, comm: MPI.Comm, arguments: Sequence[str] | None = None):
    """Parsed arguments, and their `defaults` by name; rank 0 alone prints.

    What argparse does not know goes to PETSc.

    Raises ValueError for what argparse refuses, and for what PETSc cannot take either.
    """

    parser.error = refuse
    with open(os.devnull, "w") as nowhere:
        silent = nowhere if comm.rank > 0 else None
        with redirect_stdout(silent or sys.stdout), redirect_stderr(silent or sys.stderr):
            known, rest = parser.parse_known_args(arguments)
    known.defaults = {action.dest: action.default for action in parser._actions}
    petsc_options(rest)
    return known


def threads_per_rank(comm: MPI.Comm) -> int:
    """Cores that this rank may use for its packings.

    Those that it is bound to, or its share of the machine's where mpirun binds nothing.
    """
    allowed = len(os.sched_getaffinity(0))
    on_this_machine = comm.Split_type(MPI.COMM_TYPE_SHARED).size
    bound = allowed < (os.cpu_count() or 1)
    return allowed if bound else max(allowed // on_this_machine, 1)


class LoadProgress(terminal.LoadProgress):
    """The same on rank 0 alone."""

    def __init__(self, comm: MPI.Comm, end: float, quiet: bool = False):
        """For a load that ends at `end`."""
        super().__init__(end, quiet or comm.rank > 0)


def print_table(comm: MPI.Comm, title: str, rows: Mapping[str, str], quiet: bool = False) -> None:
    """A two-column table on rank 0."""
    terminal.print_table(title, rows, quiet or comm.rank > 0)
