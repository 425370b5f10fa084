"""A load path followed with its results on disk: fields, history, log, checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from signal import Signals as Signal
from time import perf_counter

import numpy as np
from mpi4py import MPI

from . import script
from .checkpoint import Checkpoint, CheckpointError, Checkpoints, Part, Saving, Signals
from .fem.output import Fields, History, Log
from .fem.problem import Problem
from .fem.stepping import LoadStepping, Outcome, Position, StepRecord, walk


@dataclass(frozen=True)
class Scene:
    """What to follow, and what to write of it.

    Attributes:
        problem: of the equilibrium.
        set_load: called with the load at the start and at the end of a step.
        columns: names of the columns of history.csv.
        row: measures them behind a step.
        fields: of the committed state, name -> values at the quadrature points.
        tell: a row in a few words.
        parts: what a checkpoint must hold beside the problem and its law.
    """

    problem: Problem
    set_load: Callable[[float, float], None]
    columns: tuple[str, ...]
    row: Callable[[StepRecord], dict[str, float]]
    fields: Callable[[], dict[str, np.ndarray]]
    tell: Callable[[dict[str, float]], str]
    parts: Mapping[str, Part] | None = None


@dataclass
class Run:
    """How the load path ended, a row per step, and the seconds that solving took.

    signal: number of the one that stopped it; 0 for none.
    """

    outcome: Outcome
    rows: list[dict[str, float]]
    solving: float
    signal: int = 0

    @property
    def ending(self) -> str:
        """How it ended, in a few words."""
        if self.signal:
            how = f"stopped by {Signal(self.signal).name}"
        else:
            how = self.outcome.lost_controllability or "the end is reached"
        return f"{how} at load {self.outcome.load:.6g}, step {self.outcome.steps}"


def follow(
    scene: Scene,
    end: float,
    stepping: LoadStepping,
    path: Path,
    quiet: bool = False,
    saving: Saving | None = None,
) -> Run:
    """Walk the load from 0, or from where a checkpoint was written, to `end`.

    A signal (see `checkpoint.SIGNALS`) gives up the step that is being solved, writes a checkpoint
    and ends the walk.

    Args:
        scene: at its beginning.
        end: of the load.
        stepping: sizes of steps.
        path: of the fields, without suffix; history.csv and run.log go beside them.
        quiet: show no progress.
        saving: checkpoints to write, and perhaps one to go on from.

    Raises:
        ValueError: a checkpoint of another scene, damaged, or at the end already.
        OSError: results cannot be written.
    """
    saved, start, rows = _saved(scene, saving, end)
    with ExitStack() as stack:
        journal = _Journal(stack, scene, end, path, quiet, saving, saved, start, rows)
        started = perf_counter()
        outcome = walk(
            scene.problem, scene.set_load, end, stepping, journal.observe, start, journal.between
        )
        solving = perf_counter() - started - journal.seconds
        return journal.finish(outcome, solving)


class _Journal:
    """Writes what happens on the way."""

    def __init__(self, stack, scene: Scene, end, path: Path, quiet, saving, saved, start, rows):
        problem, points = scene.problem, scene.problem.operator.points
        comm = points.mesh.comm
        self._comm, self._scene, self._saving = comm, scene, saving
        self._at, self._rows = start, rows
        self.seconds = 0.0  # spent here
        self._signals = stack.enter_context(Signals())
        self._progress = stack.enter_context(script.LoadProgress(comm, end, quiet))
        self._log = stack.enter_context(Log(comm, path.parent / "run.log", saved is not None))
        keep = 0 if saved is None else start.steps + 1
        self._fields = stack.enter_context(Fields(path, points, problem.motion.displacement, keep))
        self._history = stack.enter_context(
            History(comm, path.parent / "history.csv", scene.columns, rows)
        )
        problem.operator.interrupted = lambda: self._signals.received > 0
        parts, self._checkpoints = parts_of(scene), None
        if saving is not None:
            goes_on = None if saved is None else start.steps
            self._checkpoints = Checkpoints(comm, saving, parts, goes_on)
        self._log.say(f"ranks: {comm.size}, quadrature points: {comm.allreduce(points.size)}")
        if saved is None:
            self._fields.write(start.load, scene.fields())
        else:
            saved.load(parts)
            for line in (*saved.refused, f"going on from {saved.path}, load {start.load:.6g}"):
                self._say(line)

    def _say(self, line: str) -> None:
        self._log.say(line)
        self._progress.say(line)

    def observe(self, record: StepRecord) -> None:
        """An accepted step: a row and fields."""
        started = perf_counter()
        row = self._scene.row(record)
        self._rows.append(row)
        self._history.write(row)
        self._fields.write(record.load, self._scene.fields())
        told = self._scene.tell(row)
        self._progress.show(record.load, told)
        self._log.say(f"step {record.number}  {told}  {record.seconds:.1f} s{self._balance()}")
        self.seconds += perf_counter() - started

    def _balance(self) -> str:
        """What distributed packings tell of the ranks' loads."""
        balance = getattr(self._scene.problem.operator.law, "balance", None)
        if balance is None:
            return ""
        told = f"  busiest rank over mean {balance.before:.2f}"
        return f"{told} -> {balance.after:.2f}, {balance.moved} moved" if balance.moved else told

    def between(self, position: Position) -> None:
        """Behind an observed step: a checkpoint, if one is due."""
        self._at = position
        if self._checkpoints and self._checkpoints.due(position.steps):
            self._save()

    def _save(self) -> None:
        started = perf_counter()
        try:
            written = self._checkpoints.write(self._at.steps, _common(self._at, self._rows))
        except CheckpointError as error:
            if self._saving.stop_on_failure:
                raise
            self._say(f"{error}; the run goes on")
        else:
            if written:
                size, seconds = written.bytes / 1e6, written.seconds
                self._log.say(f"checkpoint {written.path}: {size:.1f} MB in {seconds:.2f} s")
        self.seconds += perf_counter() - started

    def finish(self, outcome: Outcome, solving: float) -> Run:
        """The last checkpoint and the last line."""
        if self._checkpoints:
            self._save()
        stopped = self._signals.on_any_rank(self._comm) if outcome.interrupted else 0
        run = Run(outcome, self._rows, solving, stopped)
        self._log.say(run.ending)
        return run


def parts_of(scene: Scene) -> dict[str, Part]:
    """What a checkpoint holds: the mesh's motion by cell, the law by point, and the scene's own.

    By point too: what the weak form remembers.
    """
    points, law = scene.problem.operator.points, scene.problem.operator.law
    numbers = getattr(law, "numbers", None)  # of distributed packings, which are not at home here
    by_point = (lambda: points.index) if numbers is None else (lambda: law.numbers)
    cells = np.asarray(points.mesh.topology.original_cell_index, np.int64)
    return {
        "problem": Part(scene.problem, lambda: cells[points.cells], lambda: cells),
        "law": Part(law, by_point, by_point),
        **{
            state.name: Part(state, lambda: points.index, lambda: points.index)
            for state in scene.problem.operator.states
        },
        **(scene.parts or {}),
    }


def _saved(
    scene: Scene, saving: Saving | None, end: float
) -> tuple[Checkpoint | None, Position, list[dict[str, float]]]:
    """The checkpoint to go on from, if any, with its position and rows of the history."""
    if saving is None or not saving.resume:
        return None, Position(), []
    comm: MPI.Comm = scene.problem.operator.points.mesh.comm
    saved = Checkpoint.last(comm, saving.folder)
    saved.check_scene(saving)
    names = [f.name for f in fields(Position) if f"position/{f.name}" in saved.common]
    start = Position(**{name: saved.common[f"position/{name}"].item() for name in names})
    if not start.load < end:
        raise ValueError(
            f"{saved.path}: the load {start.load:.6g} is reached already; ask for more than"
            f" {end:.6g} to go on"
        )
    unknown = np.zeros(start.steps)  # to the program that wrote it
    columns = {
        name: saved.common.get(f"history/{name}", unknown) for name in scene.columns if start.steps
    }
    rows = [
        {name: values[row].item() for name, values in columns.items()} for row in range(start.steps)
    ]
    return saved, start, rows


def _common(at: Position, rows: list[dict[str, float]]) -> dict[str, np.ndarray]:
    """The position on the load path and the history, as arrays."""
    position = {f"position/{name}": np.array(value) for name, value in asdict(at).items()}
    names = rows[0] if rows else ()
    return position | {f"history/{name}": np.array([row[name] for row in rows]) for name in names}
