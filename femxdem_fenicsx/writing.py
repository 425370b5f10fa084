"""Files are written aside and renamed: a reader never meets half of one."""

from __future__ import annotations

import csv
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import h5py


@contextmanager
def aside(path: str | Path) -> Iterator[Path]:
    """A path beside `path` to write to; it takes the place of `path` where all goes well.

    Folders that are missing are made. Raises OSError, in one line that names the file, where it
    cannot be written.
    """
    path = Path(path)
    beside = path.with_name(f".{os.getpid()}.{path.name}")  # keeps the ending, which may matter
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield beside
        beside.replace(path)
    except OSError as error:
        raise OSError(f"{path}: cannot write this file: {error.strerror or error}") from None
    finally:
        if beside.exists():
            beside.unlink()


def check_writable(path: str | Path) -> None:
    """Raise OSError, in one line, where no such file or folder could be written.

    Nothing is made: what is tried is the first of its folders that there is.
    """
    path = Path(path)
    if path.is_file():
        path = path.parent
    there = next(place for place in (path, *path.absolute().parents) if place.exists())
    try:
        if not there.is_dir():
            raise NotADirectoryError(f"{there} is a file")
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise OSError(f"{path}: cannot write there: {error.strerror or error}") from None


def write_text(path: str | Path, text: str) -> None:
    """A text file; OSError as above."""
    with aside(path) as beside:
        beside.write_text(text, encoding="utf-8")


def write_whole(path: str | Path, data: bytes) -> None:
    """Bytes that are on disk before the file has its name; OSError as above."""
    with aside(path) as beside:
        write_synced(beside, data)


def write_synced(path: Path, data: bytes) -> None:
    """Write a file under its own name and wait until it is on disk."""
    with open(path, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on disk."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def hdf5_bytes(fill: Callable[[h5py.File], None]) -> bytes:
    """The bytes of an HDF5 file made in memory, which `fill` has filled.

    On a full disk, HDF5 itself fails late and unclearly; a plain write does not.
    """
    with h5py.File("in memory", "w", driver="core", backing_store=False) as file:
        fill(file)
        file.flush()
        return file.id.get_file_image()


def write_csv(path: str | Path, names: Sequence[str], rows: Sequence[Mapping[str, float]]) -> None:
    """A table with a line of names; all digits of the numbers; OSError as above."""
    with aside(path) as beside, open(beside, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([row[name] for name in names] for row in rows)


def write_json(path: str | Path, value: object) -> None:
    """A JSON file; OSError as above, ValueError for numbers that are not finite."""
    write_text(path, json.dumps(value, indent=1, allow_nan=False) + "\n")
