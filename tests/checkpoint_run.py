"""Runs for test_checkpoint.py: ``python -m tests.checkpoint_run TASK FOLDER ...`` on some ranks."""

import errno
import json
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

from femxdem_fenicsx.checkpoint import Checkpoint, Checkpoints, Part, Saving

COMM = MPI.COMM_WORLD


# A run without finite elements: its state is a function of the step alone


class Counting:
    """Rows whose values follow from the last ones, step by step."""

    def __init__(self, rows: np.ndarray, width: int):
        self.rows = rows
        self.values = np.sin(rows[:, None] + np.arange(width))

    def advance(self) -> None:
        self.values = np.cos(self.values + self.rows[:, None])

    def save(self, group) -> None:
        group["values"] = self.values

    def load(self, group) -> None:
        self.values = group["values"][()]

    def part(self) -> Part:
        return Part(self, lambda: self.rows, lambda: self.rows)


def rows_of_rank(count: int = 12) -> np.ndarray:
    return np.arange(count)[COMM.rank :: COMM.size]


def at_step(step: int, width: int, rows=None) -> Counting:
    """What a run without an end in between has at a step."""
    counting = Counting(rows_of_rank() if rows is None else rows, width)
    for _ in range(step):
        counting.advance()
    return counting


def count(folder: Path, width: int, last: int) -> None:
    """Go on from the folder's checkpoint, if there is one; tell each that has been written."""
    counting, step = at_step(0, width), 0
    saving = Saving(folder, {"width": width}, every=1)
    goes_on = None
    if list(folder.glob("step_*")):
        saved = Checkpoint.last(COMM, folder)
        saved.load({"rows": counting.part()})
        goes_on = step = int(saved.common["step"])
    checkpoints = Checkpoints(COMM, saving, {"rows": counting.part()}, goes_on)
    while step < last:
        counting.advance()
        step += 1
        checkpoints.write(step, {"step": np.array(step)})
        if COMM.rank == 0:
            print(step, flush=True)


def check(folder: Path, width: int) -> None:
    """The last checkpoint holds what its step says; tell the step."""
    saved = Checkpoint.last(COMM, folder)
    step = int(saved.common["step"])
    counting = at_step(0, width)
    saved.load({"rows": counting.part()})
    right = np.array_equal(counting.values, at_step(step, width).values)
    right = COMM.allreduce(right, MPI.LAND)
    if COMM.rank == 0:
        print(json.dumps({"step": step, "right": right}))


def full(folder: Path) -> None:
    """The disk of the last rank is full from the second checkpoint on: what all ranks say."""
    import femxdem_fenicsx.checkpoint as module

    counting = at_step(0, 50)
    checkpoints = Checkpoints(COMM, Saving(folder, {}), {"rows": counting.part()})
    checkpoints.write(1, {"step": np.array(1)})
    writes = module.write_synced

    def no_room(path, data):
        if COMM.rank == COMM.size - 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        writes(path, data)

    module.write_synced = no_room
    try:
        checkpoints.write(2, {"step": np.array(2)})
        said = "nothing"
    except OSError as error:
        said = str(error)
    module.write_synced = writes
    checkpoints.write(3, {"step": np.array(3)})
    said = COMM.gather(said)
    if COMM.rank == 0:
        print(json.dumps({"said": said, "there": sorted(os.listdir(folder))}))


# A specimen with an analytic law, as a demo runs it


def specimen(folder: Path, *options: str) -> None:
    """Compress a softening specimen.

    Options: --resume, stop (on a failure to write), end=, every=, threshold= (a law parameter), and
    what is to go wrong: kill=, term= (a signal at that evaluation, to itself), output=,
    checkpoint=, law=, solve= (an error on the last rank at that call), limit= (on file sizes).
    """
    from femxdem_fenicsx import distribution, script
    from femxdem_fenicsx.fem import problem
    from femxdem_fenicsx.fem.output import writable_folder
    from femxdem_fenicsx.fem.stepping import LoadStepping
    from femxdem_fenicsx.law import Softening
    from femxdem_fenicsx.load_path import Scene, follow
    from tests.fem.specimen import Specimen

    given = dict(option.split("=") for option in options if "=" in option)
    threshold = float(given.get("threshold", 0.02))

    class Troubled(Softening):
        calls = 0

        def evaluate(self, F):
            Troubled.calls += 1
            for name, number in (("kill", signal.SIGKILL), ("term", signal.SIGTERM)):
                if str(Troubled.calls) == given.get(name) and COMM.rank == COMM.size - 1:
                    os.kill(os.getpid(), number)
                    time.sleep(0.01)
            fail("law", Troubled.calls)
            return super().evaluate(F)

    def fail(where: str, calls: int) -> None:
        if str(calls) == given.get(where) and COMM.rank == COMM.size - 1:
            raise OSError(errno.ENOSPC, f"no room in the {where}")

    def make(numbers):
        return Troubled(len(numbers), 100.0, 0.3, threshold * (1 + 0.3 * np.sin(1.7 * numbers)))

    def law_of(points):
        return distribution.DistributedLaw(COMM, points.index, make)

    def main(comm: MPI.Comm) -> int:
        writable_folder(comm, folder)
        body = Specimen(law_of, rough=True, tolerance=1e-10)
        if "solve" in given:
            assemble = problem._dolfinx.assemble_matrix
            counted = iter(range(1, 1000))

            def assemble_matrix(*arguments):
                fail("solve", next(counted))
                assemble(*arguments)

            problem._dolfinx.assemble_matrix = assemble_matrix
        if "limit" in given:
            import resource

            limit = int(given["limit"])
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        body.pressure.value = 0.2

        def row(record):
            fail("output", record.number)
            return {"load": record.load, "step": record.number, "cuts": record.cuts,
                    "evaluations": record.evaluations, "converged": record.converged,
                    "force": body.top_force(), "volume": body.volume()}  # fmt: skip

        scene = Scene(
            body.problem,
            body.compress,
            ("step", "load", "force", "volume", "evaluations", "cuts", "converged"),
            row,
            lambda: {"stress": body.law.stress},
            lambda row: f"load {row['load']}",
        )
        saving = Saving(
            folder / "checkpoint",
            {"threshold": threshold},
            every=int(given.get("every", 1)),
            resume="--resume" in options,
            stop_on_failure="stop" in options,
        )
        end = float(given.get("end", 0.03))
        run = follow(scene, end, LoadStepping(0.002), folder / "fields", True, saving)
        return script.SIGNALLED + run.signal if run.signal else 0

    script.run(main)


if __name__ == "__main__":
    task, folder, *rest = sys.argv[1:]
    if task == "count":
        count(Path(folder), *map(int, rest))
    elif task == "check":
        check(Path(folder), int(rest[0]))
    elif task == "full":
        full(Path(folder))
    else:
        specimen(Path(folder), *rest)
