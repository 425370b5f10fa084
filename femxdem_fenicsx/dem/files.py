"""Packings in HDF5 files."""

import os
from pathlib import Path

import h5py
import numpy as np

from .contacts import LinearContact
from .packing import Packing

FORMAT, VERSION = "femxdem packing", 1
ARRAYS = ("box", "positions", "radii", "contacts", "tangential")
LAW = (
    "stiffness",
    "modulus",
    "stiffness_ratio",
    "friction",
    "cohesion",
    "viscous_damping",
)


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
            law = file.create_group("law")
            law.attrs["kind"] = type(packing.law).__name__
            law.attrs["scheme"] = packing.law.scheme
            for name in LAW:
                value = getattr(packing.law, name)
                law.attrs[name] = np.nan if value is None else value
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
            law = {name: float(file["law"].attrs[name]) for name in LAW}
            scheme = str(file["law"].attrs["scheme"])
            density, thickness = float(file.attrs["density"]), float(file.attrs["thickness"])
    except (OSError, KeyError, RuntimeError, TypeError) as error:
        reason = str(error).strip("'\"").splitlines()[0]
        raise ValueError(f"{path}: the packing file is truncated or damaged ({reason})") from None
    try:
        given = {name: None if np.isnan(value) else value for name, value in law.items()}
        contact = LinearContact(**given, scheme=scheme)
        return Packing(law=contact, density=density, thickness=thickness, **arrays)
    except ValueError as error:
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
    if file["law"].attrs["kind"] != LinearContact.__name__:
        raise ValueError(f"{path}: unknown contact law {file['law'].attrs['kind']}")
