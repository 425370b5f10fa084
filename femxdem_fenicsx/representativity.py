"""How many grains are enough? Packings of several sizes and seeds, looked at and sheared.

As Guo-Zhao section 3.2 (fig. 3), with the scatter of stiffness and strength over the seeds.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock
from time import perf_counter

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from .dem.element_tests import drained_compression
from .dem.files import load_packing, save_packing
from .dem.preparation import random_packing
from .dem.structure import structure_of
from .lab_plots import draw_contact_numbers
from .laboratory import TOLERANCE, finish, specimen
from .plotting import COLOURS, STYLE, draw_rose, save
from .writing import write_csv, write_json

#: (column, label with unit, factor) of what is compared.
MEASURES = (
    ("void_ratio", "void ratio", 1.0),
    ("coordination_number", "coordination number", 1.0),
    ("rattlers", "rattlers (%)", 1e2),
    ("fabric_anisotropy", "fabric anisotropy $F_a$", 1.0),
    ("young_modulus_Pa", "Young's modulus (MPa)", 1e-6),
    ("peak_friction_angle", "peak friction angle (°)", 1.0),
    ("critical_friction_angle", "critical friction angle (°)", 1.0),
    ("critical_void_ratio", "critical void ratio", 1.0),
)
#: Digits behind the point in the table, where it is not one.
DIGITS = {
    "void_ratio": 3, "critical_void_ratio": 3, "fabric_anisotropy": 3, "coordination_number": 2,
}  # fmt: skip
COLUMNS = (
    "dim", "grains", "seed", *(name for name, _, _ in MEASURES), "dilatancy_angle",
    "poisson_ratio", "strain_reached", "loose_increments", "seconds",
)  # fmt: skip


@dataclass(frozen=True)
class Study:
    """What is computed: sizes, seeds, pressure (Pa), axial strain, its step, the servo's tolerance.

    A step must be smaller than the strain at which a packing unloads, p / E: that is 4e-3 for disks
    and 6e-4 for spheres at the standard stiffness. Two lateral stresses at once scatter by
    about 1 % of the pressure from one evaluation to the next, so that a servo cannot do better.
    """

    disks: tuple[int, ...] = (100, 200, 400, 800, 1600)
    spheres: tuple[int, ...] = (200, 500, 1000)
    seeds: int = 10
    pressure: float = 1e5
    strain: float = 0.3
    step: float = 2e-3
    sphere_step: float = 5e-4
    tolerance: float = TOLERANCE
    sphere_tolerance: float = 1e-2

    def __post_init__(self):
        if self.seeds < 2:
            raise ValueError(f"a scatter needs 2 seeds or more, got {self.seeds}")
        if not 0 < self.pressure < np.inf:
            raise ValueError(f"the pressure must be positive, got {self.pressure}")
        longest = max(self.step, self.sphere_step)
        if not longest <= self.strain < 0.5:
            raise ValueError(f"the strain must be in [{longest}, 0.5[, got {self.strain}")
        if not self.cases:
            raise ValueError("give one size of packing or more")
        if min(self.disks + self.spheres) < 50:
            raise ValueError("packings of fewer than 50 grains meet their own images")

    @property
    def cases(self) -> list[tuple[int, int, int]]:
        """(dim, grains, seed), the most expensive last."""
        sizes = [(2, n) for n in self.disks] + [(3, n) for n in self.spheres]
        return [(dim, n, seed) for dim, n in sizes for seed in range(1, self.seeds + 1)]

    @property
    def settings(self) -> dict[str, float]:
        """What every row depends on."""
        sizes = ("disks", "spheres", "seeds")
        return {name: value for name, value in asdict(self).items() if name not in sizes}


QUICK = Study(disks=(100, 200, 400), spheres=(200,), seeds=3, strain=0.1)


def run(
    study: Study,
    folder: Path,
    threads: int = 1,
    progress: Callable[[int, dict], None] = lambda done, row: None,
) -> list[dict]:
    """All rows of the study, in order; each is written to `rows.csv` when it is there.

    Rows that the file has already are kept. The packings lie beside it.

    Raises ValueError where the folder holds another study, and what preparing raises.
    """
    _claim(study, folder)
    rows = {_key(row): row for row in _read(folder / "rows.csv")}
    missing = [case for case in study.cases if case not in rows]
    lock = Lock()

    def one(case: tuple[int, int, int]) -> None:
        row = _row(study, folder, *case)
        with lock:
            rows[case] = row
            write_csv(folder / "rows.csv", COLUMNS, [rows[key] for key in sorted(rows)])
            progress(len(rows), row)

    with ThreadPoolExecutor(threads) as pool:
        running = [pool.submit(one, case) for case in missing]
        try:
            for future in as_completed(running):
                future.result()
        finally:
            pool.shutdown(cancel_futures=True)
    return [rows[case] for case in study.cases]


def _claim(study: Study, folder: Path) -> None:
    """Write down what the folder is for; sizes and seeds may grow, the test may not change."""
    path = folder / "study.json"
    if path.exists():
        try:
            there = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            raise ValueError(f"{path}: this file is damaged; choose another folder") from None
        if there != study.settings:
            raise ValueError(
                f"{folder} holds rows of another test ({there}); choose another folder"
            )
    write_json(path, study.settings)


def _key(row: dict) -> tuple[int, int, int]:
    return int(row["dim"]), int(row["grains"]), int(row["seed"])


def _read(path: Path) -> list[dict]:
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        try:
            return [
                {name: None if row[name] == "" else float(row[name]) for name in COLUMNS}
                | {name: int(float(row[name])) for name in ("dim", "grains", "seed")}
                for row in csv.DictReader(file)
            ]
        except (KeyError, TypeError, ValueError):
            raise ValueError(f"{path}: this table is damaged; take it away") from None


def packing_path(folder: Path, dim: int, grains: int, seed: int) -> Path:
    """Where a packing of the study lies."""
    kind = "disks" if dim == 2 else "spheres"
    return folder / "packings" / f"{kind}-{grains:04d}-{seed:02d}.h5"


def _row(study: Study, folder: Path, dim: int, grains: int, seed: int) -> dict:
    """Prepare, look at and shear one packing."""
    started = perf_counter()
    packing = random_packing(grains, pressure=study.pressure, seed=seed, dim=dim)
    save_packing(packing_path(folder, dim, grains, seed), packing)
    found = structure_of(packing)
    tolerance = study.tolerance if dim == 2 else study.sphere_tolerance
    step, fine = (study.step, 10) if dim == 2 else (study.sphere_step, 3)
    made = specimen(packing, tolerance=tolerance)
    test = drained_compression(made.servo, study.pressure, study.strain, step, fine=fine)
    finish(made, test)
    told = made.strength
    return {
        "dim": dim,
        "grains": grains,
        "seed": seed,
        "void_ratio": found.void_ratio,
        "coordination_number": found.coordination_number,
        "rattlers": found.rattlers,
        "fabric_anisotropy": found.fabric_anisotropy,
        "young_modulus_Pa": told.young_modulus,
        "peak_friction_angle": told.peak_friction_angle,
        "critical_friction_angle": told.critical_friction_angle,
        "critical_void_ratio": told.critical_void_ratio,
        "dilatancy_angle": told.dilatancy_angle,
        "poisson_ratio": told.poisson_ratio,
        "strain_reached": made.states[-1].axial_strain,
        "loose_increments": made.servo.loose,
        "seconds": perf_counter() - started,
    }


def describe(row: dict) -> str:
    """One line of progress."""
    kind = "disks" if row["dim"] == 2 else "spheres"
    return (
        f"{row['grains']:.0f} {kind}, seed {row['seed']:.0f}: peak"
        f" {row['peak_friction_angle']:.1f} degrees"
    )


def grouped(rows: Sequence[dict]) -> dict[tuple[int, int], list[dict]]:
    """Rows by (dim, grains)."""
    groups: dict[tuple[int, int], list[dict]] = {}
    for row in rows:
        groups.setdefault((int(row["dim"]), int(row["grains"])), []).append(row)
    return groups


def _values(rows: Sequence[dict], name: str) -> np.ndarray:
    return np.array([row[name] for row in rows if row[name] is not None], float)


def table(rows: Sequence[dict], dim: int) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells of mean±standard deviation over the seeds, one column per size."""
    groups = {n: group for (d, n), group in grouped(rows).items() if d == dim}
    cells = [("packings", *(str(len(group)) for group in groups.values()))]
    for name, label, factor in MEASURES:
        line = [label.replace("$F_a$", "F_a")]
        for group in groups.values():
            values = factor * _values(group, name)
            digits = DIGITS.get(name, 1)
            line.append(
                f"{values.mean():.{digits}f}±{values.std(ddof=1):.{digits}f}"
                if len(values) > 1
                else "–"
            )
        cells.append(tuple(line))
    return ("grains", *map(str, groups)), cells


def summary(rows: Sequence[dict]) -> tuple[tuple[str, ...], list[dict]]:
    """The same numbers for a file: column names and rows."""
    found = []
    for (dim, grains), group in grouped(rows).items():
        line: dict[str, object] = {"dim": dim, "grains": grains, "tests": len(group)}
        for name, _, _ in MEASURES:
            values = _values(group, name)
            line[f"{name}_mean"] = float(values.mean()) if len(values) else None
            line[f"{name}_deviation"] = float(values.std(ddof=1)) if len(values) > 1 else None
        found.append(line)
    return tuple(found[0]), found


def draw(study: Study, folder: Path, rows: Sequence[dict]) -> None:
    """`disks.png`, `spheres.png`: all measures over the number of grains; `structure.png`:
    contact numbers and roses of one packing of each size (Guo-Zhao fig. 3)."""
    for dim, kind in ((2, "disks"), (3, "spheres")):
        if any(row["dim"] == dim for row in rows):
            _draw_scatter(folder / f"{kind}.png", [r for r in rows if r["dim"] == dim], kind)
    if study.disks:
        _draw_structure(study, folder)


@matplotlib.rc_context(STYLE)
def _draw_scatter(path: Path, rows: Sequence[dict], kind: str) -> None:
    """A point per packing, the mean, and a bar of one standard deviation to both sides."""
    figure = Figure((7.0, 3.6), layout="constrained")
    panels = figure.subplots(2, 4, sharex=True).ravel()
    for axes, (name, label, factor) in zip(panels, MEASURES, strict=True):
        for (_, size), group in grouped(rows).items():
            values = factor * _values(group, name)
            axes.plot(np.full(len(values), size), values, ".", ms=3.5, color="0.6", mew=0)
            if len(values) > 1:
                axes.errorbar(
                    size, values.mean(), values.std(ddof=1), fmt="_", ms=9, color=COLOURS[0],
                    lw=1.2, capsize=2,
                )  # fmt: skip
        axes.set(xscale="log", ylabel=label)
        sizes = sorted({int(row["grains"]) for row in rows})
        axes.set_xticks(sizes, [str(size) for size in sizes], size="x-small")
        axes.set_xlim(sizes[0] / 1.4, sizes[-1] * 1.4)
        axes.xaxis.set_minor_locator(NullLocator())
    for axes in panels[4:]:
        axes.set_xlabel(kind)
    save(figure, path)


@matplotlib.rc_context(STYLE)
def _draw_structure(study: Study, folder: Path) -> None:
    chosen = study.disks[:3]
    packings = [(f"{n} disks", load_packing(packing_path(folder, 2, n, 1))) for n in chosen]
    figure = Figure((7.0, 2.4), layout="constrained")
    grid = figure.add_gridspec(1, len(chosen) + 1, width_ratios=[1.4, *[1] * len(chosen)])
    draw_contact_numbers(figure.add_subplot(grid[0, 0]), packings)
    for k, (title, packing) in enumerate(packings, 1):
        axes = figure.add_subplot(grid[0, k], projection="polar")
        draw_rose(axes, packing)
        axes.set_title(title)
    save(figure, folder / "structure.png")
