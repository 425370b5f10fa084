"""A user's own path for an element test, from a CSV file.

One row is one leg of the path; its cells say what is reached at its end, and how. Columns:
`strain_xx`, ... (compression positive) or `stress_xx_Pa`, ... (compression positive), `gamma_xy`,
... or `tau_xy_Pa`, ... for shear, and `increments`. A component that has both columns has one cell
filled in every row. A component without a column keeps its strain.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

#: Increments of a leg where the file has no column for them.
INCREMENTS = 10
AXES = "xyz"


@dataclass(frozen=True)
class Leg:
    """A straight piece of a path.

    controlled (d, d) bool: where stress is prescribed; strained (d, d) bool: where strain is, and
    elsewhere it stays as it is; deformation (d, d): F at the end; stress (d, d) Pa at the end,
    tension positive; increments: how many lead there.
    """

    controlled: np.ndarray
    strained: np.ndarray
    deformation: np.ndarray
    stress: np.ndarray
    increments: int


def columns(dim: int) -> dict[str, tuple[str, int, int]]:
    """(kind, i, j) by name of column; kind is strain or stress; i <= j."""
    known = {}
    for i in range(dim):
        for j in range(i, dim):
            pair = AXES[i] + AXES[j]
            strain, stress = ("strain", "stress") if i == j else ("gamma", "tau")
            known[f"{strain}_{pair}"] = ("strain", i, j)
            known[f"{stress}_{pair}_Pa"] = ("stress", i, j)
    return known


def read_path(path: str | Path, dim: int) -> list[Leg]:
    """The legs of a file.

    Raises ValueError, in one line that names the file, the line and what is wrong with it.
    """
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if row and not row[0].startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise ValueError(f"{path}: cannot read the path: {reason}") from None
    if len(rows) < 2:
        raise ValueError(f"{path}: a path needs a line of column names and one row or more")
    names = [name.strip() for name in rows[0]]
    _check_names(path, names, dim)
    legs = []
    for number, row in enumerate(rows[1:], 1):
        where = f"{path}, row {number} below the column names"
        if len(row) != len(names):
            raise ValueError(f"{where}: {len(row)} cells, there are {len(names)} columns")
        cells = dict(zip(names, (cell.strip() for cell in row), strict=True))
        legs.append(_leg(where, cells, dim))
    return legs


def _check_names(path, names: list[str], dim: int) -> None:
    known = columns(dim)
    for name in names:
        if name not in known and name != "increments":
            raise ValueError(
                f"{path}: unknown column '{name}'; choose from {', '.join(known)}, increments"
            )
        if names.count(name) > 1:
            raise ValueError(f"{path}: there are two columns '{name}'")
    if set(names) <= {"increments"}:
        raise ValueError(f"{path}: no column prescribes a strain or a stress")


def _leg(where: str, cells: dict[str, str], dim: int) -> Leg:
    controlled, strained = np.zeros((2, dim, dim), bool)
    deformation, stress = np.eye(dim), np.zeros((dim, dim))
    filled: dict[tuple[int, int], str] = {}
    known = columns(dim)
    for name, cell in cells.items():
        if name == "increments" or cell == "":
            continue
        kind, i, j = known[name]
        if (i, j) in filled:
            raise ValueError(
                f"{where}: both '{filled[i, j]}' and '{name}' are given; leave one out"
            )
        filled[i, j] = name
        value = _number(where, name, cell)
        sign = -1.0 if i == j else 1.0
        if kind == "stress":
            controlled[i, j], stress[i, j] = True, sign * value
        else:
            strained[i, j] = True
            deformation[i, j] += sign * value
            if i == j and value >= 1:
                raise ValueError(f"{where}: {name} = {value:g} leaves nothing of the box")
    for name in cells:
        if name != "increments" and known[name][1:] not in filled:
            raise ValueError(f"{where}: there is a gap, '{name}' is empty")
    increments = INCREMENTS
    if "increments" in cells:
        count = _number(where, "increments", cells["increments"] or "nan")
        if count != int(count) or count < 1:
            raise ValueError(f"{where}: increments must be a whole number above 0, got {count:g}")
        increments = int(count)
    return Leg(controlled, strained, deformation, stress, increments)


def _number(where: str, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise ValueError(f"{where}: {name} is no number: '{cell}'") from None
    if not np.isfinite(value):
        raise ValueError(f"{where}: {name} must be a finite number, got '{cell}'")
    return value
