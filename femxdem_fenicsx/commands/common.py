"""Options and steps that several subcommands share."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import h5py
import numpy as np

from ..dem.accuracy import PRESETS
from ..dem.files import load_packing
from ..dem.grain_sizes import GrainSizes, UniformByNumber, UniformByVolume, read_sieve_curve
from ..dem.packing import Packing
from ..dem.preparation import DENSITIES


def read_packing(path: Path) -> Packing:
    """A packing of either dimension; ValueError, naming the file, for what is none."""
    dim = 2
    try:
        with h5py.File(path, "r") as file:
            dim = 3 if file.attrs.get("dim") == 3 else 2
    except OSError:
        pass  # the reader below says what is wrong
    return load_packing(path, dim)


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """--quiet."""
    parser.add_argument("--quiet", action="store_true", help="no progress, no table")


def add_accuracy(parser: argparse.ArgumentParser) -> None:
    """--accuracy."""
    parser.add_argument("--accuracy", default="balanced", choices=list(PRESETS))


def add_grains(group: argparse._ArgumentGroup) -> None:
    """Number and sizes of the grains, which `sizes_of` reads."""
    group.add_argument("--dim", type=int, default=2, choices=(2, 3), help="2: disks, 3: spheres")
    group.add_argument("--grains", type=int, default=400)
    group.add_argument(
        "--radii", type=float, nargs=2, default=(3e-3, 7e-3), metavar=("MIN", "MAX"), help="m"
    )
    group.add_argument(
        "--uniform", choices=("number", "volume"), default="number",
        help="what is the same for every radius between the two",
    )  # fmt: skip
    group.add_argument(
        "--sieve", type=Path, metavar="CSV",
        help="grain-size curve instead: diameter in mm, passing in %%",
    )  # fmt: skip


def sizes_of(args: argparse.Namespace) -> GrainSizes:
    """The distribution that the options describe; ValueError for what is none."""
    if args.sieve is not None:
        return read_sieve_curve(args.sieve)
    kind = UniformByNumber if args.uniform == "number" else UniformByVolume
    return kind(*args.radii)


def add_density(group: argparse._ArgumentGroup) -> None:
    """How dense: a class, or the compaction friction itself."""
    how = group.add_mutually_exclusive_group()
    how.add_argument(
        "--density", choices=list(DENSITIES), default="dense",
        help="by the friction while it is compacted: "
        + ", ".join(f"{name} {friction:g}" for name, friction in DENSITIES.items()),
    )  # fmt: skip
    how.add_argument("--compaction-friction", type=float, help="that friction itself")


def compaction_friction_of(args: argparse.Namespace) -> float:
    """Of the options above."""
    given = args.compaction_friction
    return DENSITIES[args.density] if given is None else given


def add_threads(parser: argparse.ArgumentParser) -> None:
    """--threads."""
    parser.add_argument("--threads", type=int, help="(default: all cores)")


def threads_of(args: argparse.Namespace) -> int:
    """ValueError for none."""
    if args.threads is not None and args.threads < 1:
        raise ValueError(f"--threads must be 1 or more, got {args.threads}")
    return args.threads or len(os.sched_getaffinity(0))


def pressure_of(values: list[float], dim: int) -> float | np.ndarray:
    """One pressure, or one per axis; ValueError otherwise."""
    if len(values) not in (1, dim):
        raise ValueError(f"--pressure: give one value or {dim}, one per axis, not {len(values)}")
    return values[0] if len(values) == 1 else np.array(values)
