"""Packings in HDF5 files."""

import os
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np

from .contacts import ContactLaw
from .packing import Packing

FORMAT, VERSION = "femxdem packing", 1
ARRAYS = ("box", "positions", "radii", "contacts", "tangential")
#: Arrays of packings whose contact law has them.
MEMORY = ("rolling", "bonded")


def save_packing(path: str | Path, packing: Packing) -> None:
    """Write the packing to `path`, aside first, so that no half-written file is ever left."""
    path = Path(path)
    aside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(aside, "w") as file:
            file.attrs.update(format=FORMAT, version=VERSION, dim=packing.dim)
            file.attrs.update(density=packing.density, thickness=packing.thickness)
            for name in ARRAYS:
                file[name] = getattr(packing, name)
            for name in MEMORY:
                if getattr(packing, name) is not None:
                    file[name] = getattr(packing, name)
            _save_law(packing.law, file.create_group("law"))
        aside.replace(path)
    except OSError as error:
        raise OSError(f"{path}: cannot write the packing: {error.strerror or error}") from None
    finally:
        if aside.exists():
            aside.unlink()


def load_packing(path: str | Path, dim: int = 2) -> Packing:
    """Read a packing of that dimension.

    Raises ValueError, in one line that names the file, where it is not there, is truncated, is no
    packing, has another dimension or another version.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: there is no such packing file")
    try:
        with h5py.File(path, "r") as file:
            _check_header(path, file, dim)
            arrays = {name: file[name][()] for name in ARRAYS}
            arrays |= {name: file[name][()] for name in MEMORY if name in file}
            kind, values = _load_law(file["law"])
            density, thickness = float(file.attrs["density"]), float(file.attrs["thickness"])
    except (OSError, KeyError, RuntimeError, TypeError) as error:
        reason = str(error).strip("'\"").splitlines()[0]
        raise ValueError(f"{path}: the packing file is truncated or damaged ({reason})") from None
    try:
        law = _kind_of_law(kind)(**values)
        return Packing(law=law, density=density, thickness=thickness, **arrays)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None


def _check_header(path: Path, file: h5py.File, dim: int) -> None:
    if file.attrs.get("format") != FORMAT:
        raise ValueError(f"{path}: this HDF5 file is not a packing")
    if file.attrs.get("version") != VERSION:
        raise ValueError(
            f"{path}: packing format version {file.attrs.get('version')}, this program reads"
            f" version {VERSION}; prepare the packing again"
        )
    if file.attrs.get("dim") != dim:
        raise ValueError(f"{path}: a packing of {file.attrs.get('dim')} dimensions, need {dim}")


def _save_law(law: ContactLaw, group: h5py.Group) -> None:
    """All fields of the law: numbers and words, NaN for None; of its parts as lists of numbers."""
    group.attrs["kind"] = type(law).__name__
    for field in fields(law):
        value = getattr(law, field.name)
        group.attrs[field.name] = np.nan if value is None else value


def _load_law(group: h5py.Group) -> tuple[str, dict[str, float | str | tuple[float, ...] | None]]:
    """Name of the class and its arguments. What the file does not have takes its default."""
    values = {}
    for name, value in group.attrs.items():
        if isinstance(value, str):
            values[name] = value
        elif np.ndim(value):
            values[name] = tuple(map(float, value))
        else:
            values[name] = None if np.isnan(value) else float(value)
    return str(values.pop("kind")), values


def _kind_of_law(name: str) -> type[ContactLaw]:
    """The class of that name, of this program or of whoever has defined one before."""
    pending = [ContactLaw]
    while pending:
        kind = pending.pop()
        if kind.__name__ == name and kind is not ContactLaw:
            return kind
        pending.extend(kind.__subclasses__())
    raise ValueError(f"unknown contact law {name}; import the module that defines it first")
