"""Runs for test_checkpoint.py: ``python -m tests.checkpoint_run TASK FOLDER ...`` on some ranks."""

import errno
import hashlib
import json
import os
import signal
import sys
import time
import traceback
from pathlib import Path

import h5py
import mpi4py
import numpy as np

mpi4py.rc.initialize = "lives" not in sys.argv

from mpi4py import MPI  # noqa: E402

from femxdem_fenicsx.checkpoint import Checkpoint, Checkpoints, Part, Saving  # noqa: E402

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


def at_step(step: int, width: int) -> Counting:
    """What a run without an end in between has at a step, on this rank."""
    counting = Counting(np.arange(12)[COMM.rank :: COMM.size], width)
    for _ in range(step):
        counting.advance()
    return counting


def count(folder: Path, width: int, told: int, pipe: int) -> None:
    """Go on from the folder's checkpoint and write one each step, for ever; tell it to the pipe.

    What has been told must be there, and be what a run without an end in between has.
    """
    counting, step, goes_on = at_step(0, width), 0, None
    if told > 0:
        saved = Checkpoint.last(COMM, folder)
        saved.load({"rows": counting.part()})
        goes_on = step = int(saved.common["step"])
        assert step >= told, f"step {told} was written, {step} is found"
        assert np.array_equal(counting.values, at_step(step, width).values)
    checkpoints = Checkpoints(COMM, Saving(folder, {}), {"rows": counting.part()}, goes_on)
    while True:
        counting.advance()
        step += 1
        checkpoints.write(step, {"step": np.array(step)})
        os.write(pipe, step.to_bytes(4, "little"))


def lives(folder: Path, kills: int) -> None:
    """Kill `count` at random moments, and go on each time: how far it came, what was cut short."""
    moments = np.random.default_rng(11)
    told, partial = 0, 0
    for life in range(kills + 1):
        hear, say = os.pipe()
        child = os.fork()  # MPI starts in the child
        if child == 0:
            try:
                MPI.Init()
                count(folder, 10_000, told, say)
            finally:
                traceback.print_exc()
                os._exit(3)
        os.close(say)
        first = os.read(hear, 4)  # it is up
        time.sleep(moments.uniform(0, 0.05) if life < kills else 0)
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        if not first or not os.WIFSIGNALED(status):
            raise SystemExit(f"life {life} ended by itself")
        heard = first
        while more := os.read(hear, 4096):
            heard += more
        os.close(hear)
        told = int.from_bytes(heard[-4:], "little")
        partial += bool(list(folder.glob(".*.partial")))
    print(json.dumps({"steps": told, "partial": partial}))


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

    Options: --resume, digest (of the state), stop (on a failure to write), end=, every=,
    threshold=, modulus= (of the law, of the second gradient), and what is to go wrong: kill=,
    term= (a signal at that evaluation), law=, output=, solve= (an error of a rank at that call),
    limit= (on file sizes).
    """
    from femxdem_fenicsx import distribution, script
    from femxdem_fenicsx.fem import problem
    from femxdem_fenicsx.fem.output import History, writable_folder
    from femxdem_fenicsx.fem.stepping import LoadStepping
    from femxdem_fenicsx.law import Softening
    from femxdem_fenicsx.load_path import Scene, follow, parts_of
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

    def fail(where: str, calls: int, rank: int = COMM.size - 1) -> None:
        if str(calls) == given.get(where) and COMM.rank == rank:
            raise OSError(errno.ENOSPC, f"no room in the {where}")

    def make(numbers):
        return Troubled(len(numbers), 100.0, 0.3, threshold * (1 + 0.3 * np.sin(1.7 * numbers)))

    def law_of(points):
        return distribution.DistributedLaw(COMM, points.index, make)

    def main(comm: MPI.Comm) -> int:
        writable_folder(comm, folder)
        modulus = float(given["modulus"]) if "modulus" in given else None
        body = Specimen(law_of, rough=True, tolerance=1e-10, modulus=modulus)
        if "solve" in given:
            assemble = problem._dolfinx.assemble_matrix
            counted = iter(range(1, 1000))

            def assemble_matrix(*arguments):
                fail("solve", next(counted))
                assemble(*arguments)

            problem._dolfinx.assemble_matrix = assemble_matrix
        if "output" in given:
            append, rows = History._append, iter(range(1, 1000))

            def _append(self, row):
                fail("output", next(rows), rank=0)
                append(self, row)

            History._append = _append
        if "limit" in given:
            import resource

            limit = int(given["limit"])
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        body.pressure.value = 0.2

        def row(record):
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
        if "digest" in options and saving.resume:
            Checkpoint.last(comm, saving.folder).load(parts_of(scene))
            print_digest(parts_of(scene))
        run = follow(scene, end, LoadStepping(0.002), folder / "fields", True, saving)
        if "digest" in options:
            print_digest(parts_of(scene))
        return script.SIGNALLED + run.signal if run.signal else 0

    script.TOGETHER = 1.0
    script.run(main)


def print_digest(parts: dict[str, Part]) -> None:
    """A checksum over all rows of the state, in the order of their numbers."""
    digest = hashlib.sha256()
    for name, part in parts.items():
        with h5py.File(name, "w", driver="core", backing_store=False) as file:
            part.thing.save(file)
            arrays = {dataset: file[dataset][()] for dataset in file}
        for dataset in sorted(arrays):
            told = COMM.gather((part.saves(), arrays[dataset]))
            if told:
                order = np.argsort(np.concatenate([numbers for numbers, _ in told]))
                rows = np.concatenate([rows for _, rows in told])[order]
                digest.update(f"{name}/{dataset} {rows.shape}".encode() + rows.tobytes())
    if COMM.rank == 0:
        print(digest.hexdigest())


if __name__ == "__main__":
    task, folder, *rest = sys.argv[1:]
    if task == "lives":
        lives(Path(folder), int(rest[0]))
    elif task == "full":
        full(Path(folder))
    else:
        specimen(Path(folder), *rest)
