"""Checkpoints: a run that ends before its time loses what it did since the last one.

A checkpoint is a folder ``step_000120`` of HDF5 files: one of each rank, ``rank_0000.h5``, with the
rows of its cells and packings, and ``manifest.h5``, with all that there is once. ``SHA256SUMS``
holds a checksum of each (``sha256sum --check SHA256SUMS``). No rank ever holds the state of another
one: what thousands of ranks write and read does not go through one of them.

It is written under another name, brought to disk and renamed; the last two are kept. Rows have the
number of their cell or point in the whole mesh, so that any number of ranks can take them up.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

import h5py
import numpy as np
from mpi4py import MPI

from .collective import together
from .writing import hdf5_bytes, sync_folder, write_synced

#: Format 1 knows nothing of what the solver has learnt, and reads as one without.
FORMAT, VERSION = "femxdem checkpoint", 2
MANIFEST, SUMS = "manifest.h5", "SHA256SUMS"
#: Checkpoints that are kept.
KEPT = 2
#: Time between two of them, s, unless a number of steps is asked for.
INTERVAL = 600.0
#: Signals that ask a run to write a checkpoint and stop; mpirun hands on the last one.
SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)


class Saved(Protocol):
    """What a checkpoint can hold."""

    def save(self, group: h5py.Group) -> None:
        """Write datasets of equal length, one row for each of its numbers."""
        ...

    def load(self, group: h5py.Group) -> None:
        """Read them back: rows of the numbers that it loads."""
        ...


class Part(NamedTuple):
    """Something to save, and which numbers (of cells, of points) its rows have on this rank.

    saves: numbers of the rows that it writes, each of them on one rank alone.
    loads: numbers of the rows that it wants to read.
    """

    thing: Saved
    saves: Callable[[], np.ndarray]
    loads: Callable[[], np.ndarray]


@dataclass(frozen=True)
class Saving:
    """How a run is to be saved.

    Attributes:
        folder: for its checkpoints alone.
        scene: name -> value of all that a run that goes on with it must share.
        defaults: of the names in `scene` that an older program may not have known, and of others,
            which may differ.
        packing: bytes of its packing's file.
        every: load steps between two checkpoints; None: one each `INTERVAL`.
        resume: go on from the last checkpoint in the folder.
        stop_on_failure: end the run where a checkpoint cannot be written; otherwise say so.
    """

    folder: Path
    scene: Mapping[str, object]
    packing: bytes = b""
    defaults: Mapping[str, object] = field(default_factory=dict)
    every: int | None = None
    resume: bool = False
    stop_on_failure: bool = False


class CheckpointError(OSError):
    """A checkpoint could not be written."""


@dataclass
class Written:
    """What writing a checkpoint took: bytes of all ranks, seconds."""

    path: Path
    bytes: int
    seconds: float


class Checkpoints:
    """Writes the checkpoints of a run into a folder. All methods are collective.

    What another run left in the folder is set aside, as ``<folder>.before``.

    Args:
        comm: ranks of the run.
        saving: where, and how often.
        parts: what to save, by name.
        goes_on: load step of the checkpoint that this run goes on with; what lies behind it in the
            folder is damaged, and is deleted.

    Raises:
        CheckpointError: the folder cannot be tidied.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        saving: Saving,
        parts: Mapping[str, Part],
        goes_on: int | None = None,
    ):
        self._comm, self._saving, self._parts = comm, saving, dict(parts)
        self._folder = Path(saving.folder)
        self._since, self._written = time.monotonic(), goes_on
        self._must(self._on_first(self._tidy, goes_on))

    def _tidy(self, goes_on: int | None) -> None:
        """Set aside another run's checkpoints, or delete those behind the one to go on with."""
        for partial in self._folder.glob(".step_*.partial"):
            shutil.rmtree(partial)
        there = complete(self._folder)
        if goes_on is not None:
            for path in there:
                if path.name > step_folder(goes_on):
                    shutil.rmtree(path)
        elif there:
            before = self._folder.with_name(f"{self._folder.name}.before")
            shutil.rmtree(before, ignore_errors=True)
            self._folder.rename(before)

    def due(self, step: int) -> bool:
        """Whether one is due behind this load step."""
        if self._saving.every is not None:
            return step % self._saving.every == 0
        return self._comm.bcast(time.monotonic() - self._since >= INTERVAL)

    def write(self, step: int, common: Mapping[str, np.ndarray]) -> Written | None:
        """Write the state behind a load step, with arrays that are the same on all ranks.

        None where that has been done. Raises CheckpointError, on all ranks, where one cannot; then
        the older ones stand.
        """
        if step == self._written:
            return None
        started = time.perf_counter()
        path = self._folder / step_folder(step)
        aside = self._folder / f".{path.name}.partial"
        self._must(self._on_first(self._make, aside), path)
        try:
            rows, (size, checksum) = {}, (0, "")
            problem = None
            try:
                data = hdf5_bytes(lambda file: rows.update(self._fill(file)))
                size, checksum = len(data), hashlib.sha256(data).hexdigest()
                write_synced(aside / rank_file(self._comm.rank), data)
            except OSError as error:
                problem = error.strerror or str(error)
            self._must(problem, path)
            told = self._comm.gather((size, checksum, rows))
            self._must(self._on_first(self._finish, aside, path, told, common), path)
        except CheckpointError:
            if self._comm.rank == 0:
                shutil.rmtree(aside, ignore_errors=True)
            raise
        self._since, self._written = time.monotonic(), step
        total = self._comm.allreduce(size)
        return Written(path, total, time.perf_counter() - started)

    def _make(self, aside: Path) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(aside, ignore_errors=True)
        aside.mkdir()

    def _fill(self, file: h5py.File) -> dict[str, np.ndarray]:
        """This rank's rows into its file; their numbers."""
        numbers = {}
        for name, part in self._parts.items():
            numbers[name] = np.asarray(part.saves(), np.int64)
            part.thing.save(file.create_group(name))
        return numbers

    def _finish(self, aside: Path, path: Path, told: list, common: Mapping) -> None:
        """Rank 0: the manifest, the checksums, the name; then the old ones go."""

        def fill(file: h5py.File) -> None:
            file.attrs.update(format=FORMAT, version=VERSION, ranks=len(told))
            file.attrs["written"] = time.strftime("%Y-%m-%d %H:%M:%S")
            file["scene"] = json.dumps(dict(self._saving.scene))
            file["packing"] = np.frombuffer(self._saving.packing, np.uint8)
            for name, array in common.items():
                file[f"common/{name}"] = array
            for name in self._parts:
                numbers = [rows[name] for _, _, rows in told]
                file[f"numbers/{name}"] = np.concatenate(numbers)
                file[f"counts/{name}"] = [len(n) for n in numbers]

        manifest = hdf5_bytes(fill)
        write_synced(aside / MANIFEST, manifest)
        sums = {rank_file(rank): checksum for rank, (_, checksum, _) in enumerate(told)}
        sums[MANIFEST] = hashlib.sha256(manifest).hexdigest()
        lines = [f"{checksum}  {name}\n" for name, checksum in sums.items()]
        write_synced(aside / SUMS, "".join(lines).encode())
        sync_folder(aside)
        aside.rename(path)
        sync_folder(self._folder)
        for old in complete(self._folder)[KEPT:]:
            shutil.rmtree(old, ignore_errors=True)

    def _on_first(self, action: Callable, *arguments) -> str | None:
        """What went wrong with it on rank 0."""
        if self._comm.rank > 0:
            return None
        try:
            action(*arguments)
        except OSError as error:
            return error.strerror or str(error)
        return None

    def _must(self, problem: str | None, path: Path | None = None) -> None:
        """Raise CheckpointError on all ranks if one of them has a problem."""
        found = [p for p in self._comm.allgather(problem) if p]
        if found and path is None:
            raise CheckpointError(found[0])
        if found:
            stands = self._comm.bcast(complete(self._folder) if self._comm.rank == 0 else None)
            rest = f"{stands[0].name} stands" if stands else "there is no older one"
            raise CheckpointError(f"{path}: checkpoint not written: {found[0]}; {rest}")


def step_folder(step: int) -> str:
    """Name of the checkpoint behind a load step."""
    return f"step_{step:06d}"


def rank_file(rank: int) -> str:
    """Name of a rank's file in a checkpoint."""
    return f"rank_{rank:04d}.h5"


def complete(folder: Path) -> list[Path]:
    """Folders of the checkpoints that have been written to the end, the last step first."""
    return sorted(folder.glob("step_[0-9]*"), key=lambda path: path.name, reverse=True)


class Checkpoint:
    """A checkpoint to go on from, whole and of a format that this program reads.

    Attributes:
        path: its folder. scene: of the run that wrote it. common: arrays that there are once.
        packing: bytes of a packing's file. refused: a line for each later one that is damaged.
    """

    def __init__(self, comm: MPI.Comm, path: Path, manifest: bytes, refused: list[str]):
        self._comm, self.path, self.refused = comm, path, refused
        with _in_memory(manifest) as file:
            self.scene = json.loads(file["scene"].asstr()[()])
            self.packing = file["packing"][()].tobytes()
            self.common = {name: file["common"][name][()] for name in _datasets(file["common"])}
            names = list(file["numbers"])
            self._numbers = {name: file[f"numbers/{name}"][()] for name in names}
            self._counts = {name: file[f"counts/{name}"][()] for name in names}

    @classmethod
    def last(cls, comm: MPI.Comm, folder: Path) -> Checkpoint:
        """The last one in the folder that is whole.

        Raises ValueError, on all ranks, where there is none, or the last has a newer format.
        """
        folder = Path(folder)
        paths = comm.bcast(complete(folder) if comm.rank == 0 else None)
        if not paths:
            raise ValueError(f"{folder}: there is no checkpoint to go on from; leave --resume away")
        refused: list[str] = []
        for path in paths:
            damage = _damage(comm, path)
            if damage is None:
                manifest = comm.bcast((path / MANIFEST).read_bytes() if comm.rank == 0 else None)
                _check_format(path, manifest)
                return cls(comm, path, manifest, refused)
            refused.append(f"{path}: {damage}")
        raise ValueError("; ".join(refused))

    def check_scene(self, saving: Saving) -> None:
        """Raise ValueError, with the first thing that differs, for another scene."""
        now, defaults = (json.loads(json.dumps(dict(m))) for m in (saving.scene, saving.defaults))
        free = defaults.keys() - now.keys()  # known here, but not to be shared (any more)
        for name in sorted((now.keys() | self.scene.keys()) - free):
            was, given = self.scene.get(name, defaults.get(name)), now.get(name)
            if was != given:
                raise ValueError(
                    f"{self.path}: the checkpoint of another run: {name} was {was}, now it is"
                    f" {given}"
                )

    def load(self, parts: Mapping[str, Part]) -> None:
        """Give the parts their rows back; ValueError, on all ranks, where one has none."""
        problem = None
        try:
            if parts.keys() != self._numbers.keys():
                raise ValueError(f"it holds {sorted(self._numbers)}, need {sorted(parts)}")
            rows = {name: self._rows(name, part.loads()) for name, part in parts.items()}
        except (ValueError, OSError, KeyError) as error:
            problem = f"{self.path}: {error}"
        found = [p for p in self._comm.allgather(problem) if p]
        if found:
            raise ValueError(found[0])
        for name, part in parts.items():
            with h5py.File(f"{self.path}/{name}", "w", driver="core", backing_store=False) as file:
                for dataset, array in rows[name].items():
                    file[dataset] = array
                together(self._comm, part.thing.load, file)

    def _rows(self, name: str, wanted: np.ndarray) -> dict[str, np.ndarray]:
        """dataset -> its rows of the wanted numbers, read from the files that have them."""
        numbers, counts = self._numbers[name], self._counts[name]
        wanted = np.asarray(wanted, np.int64)
        order = np.argsort(numbers, kind="stable")
        at = np.searchsorted(numbers, wanted, sorter=order)
        at = order[np.minimum(at, len(numbers) - 1)]
        if not np.array_equal(numbers[at], wanted):
            missing = wanted[numbers[at] != wanted][0]
            raise ValueError(f"{name} number {missing} is not in this checkpoint")
        starts = np.concatenate([[0], np.cumsum(counts)])
        rank = np.searchsorted(starts, at, side="right") - 1
        arrays: dict[str, np.ndarray] = {}
        for r in np.unique(rank) if len(rank) else [0]:
            mine = rank == r
            with h5py.File(self.path / rank_file(r), "r") as file:
                for dataset in _datasets(file[name]):
                    values = file[name][dataset][()]
                    if dataset not in arrays:
                        arrays[dataset] = np.empty((len(wanted), *values.shape[1:]), values.dtype)
                    arrays[dataset][mine] = values[at[mine] - starts[r]]
        return arrays


def _datasets(group: h5py.Group) -> list[str]:
    names: list[str] = []
    group.visititems(lambda name, item: names.append(name) if hasattr(item, "shape") else None)
    return names


def _in_memory(data: bytes) -> h5py.File:
    """An HDF5 file from its bytes."""
    return h5py.File(io.BytesIO(data), "r")


def _damage(comm: MPI.Comm, path: Path) -> str | None:
    """What is wrong with a checkpoint's files, or None; each is read by one of the ranks."""
    sums = comm.bcast(_read_sums(path) if comm.rank == 0 else None)
    if isinstance(sums, str):
        return sums
    found = None
    for name in sorted(sums)[comm.rank :: comm.size]:
        try:
            if hashlib.sha256((path / name).read_bytes()).hexdigest() != sums[name]:
                found = found or f"{name} is truncated or damaged (its checksum differs)"
        except OSError as error:
            found = found or f"{name} cannot be read: {error.strerror}"
    return next((f for f in comm.allgather(found) if f), None)


def _read_sums(path: Path) -> dict[str, str] | str:
    """Name -> checksum of all files; what is wrong, where they are not all there."""
    damaged = f"{SUMS} is missing, truncated or damaged"
    try:
        lines = (path / SUMS).read_text("ascii").splitlines()
        sums = {name: checksum for checksum, name in (line.split("  ") for line in lines)}
    except (OSError, ValueError):
        return damaged
    ranks = {rank_file(rank) for rank in range(len(sums) - 1)}
    here = {file.name for file in path.glob("*.h5")}
    return sums if sums.keys() == ranks | {MANIFEST} == here else damaged


def _check_format(path: Path, manifest: bytes) -> None:
    with _in_memory(manifest) as file:
        kind, version = file.attrs.get("format"), int(file.attrs.get("version", 0))
    if kind != FORMAT:
        raise ValueError(f"{path}: this is no checkpoint")
    if version > VERSION:
        raise ValueError(
            f"{path}: checkpoint format {version}, this program reads up to {VERSION}: go on with"
            " the version that wrote it"
        )


class Signals:
    """While entered, remembers a signal that asks the run to stop; a second one acts at once.

    Attributes:
        received: number of the signal; 0 for none.
    """

    def __init__(self):
        self.received = 0
        self._before: dict[int, object] = {}

    def __enter__(self) -> Signals:
        for number in SIGNALS:
            self._before[number] = signal.signal(number, self._note)
        return self

    def _note(self, number: int, frame) -> None:
        self.received = number
        self._restore()

    def __exit__(self, *error) -> None:
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._before.clear()

    def on_any_rank(self, comm: MPI.Comm) -> int:
        """The signal that some rank has received; 0 for none."""
        return comm.allreduce(int(self.received), MPI.MAX)
