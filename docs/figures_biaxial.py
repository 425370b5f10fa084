"""The demo (README), beside escript + YADE, and one packing beside YADE (docs/accuracy.md)."""

import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from figures_common import FIGURES, OURS, PACKING, THEIRS, keep, keep_picture, python, table
from matplotlib.figure import Figure

# figures_common tells where benchmarks are
# isort: split
import tradeoff

from femxdem_fenicsx import plotting
from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.files import load_packing

# The demo, as `make biaxial` runs it but with YADE's packing


def run_biaxial() -> None:
    with tempfile.TemporaryDirectory() as folder:
        summary = python("demos/biaxial.py", "--packing", PACKING, "--output", folder)
        for name in ("fields", "history", "force_chains"):
            keep_picture(Path(folder) / f"{name}.png", f"biaxial_{name}")
    (FIGURES / "biaxial.txt").write_text(summary)


def draw_biaxial() -> None:
    """The demo has drawn already."""


# The coupled test beside escript + YADE


def run_coupled() -> None:
    with tempfile.TemporaryDirectory() as folder:
        python(
            "demos/biaxial.py", "--quiet", "--output", folder, "--formulation", "small",
            "--packing", PACKING, "--element", "Q8",
            "--mesh", "2", "4", "--strain", "0.046",
        )  # fmt: skip
        rows = np.genfromtxt(Path(folder) / "history.csv", delimiter=",", names=True)
    names = ("axial_strain", "axial_stress_Pa", "volumetric_strain", "evaluations", "converged")
    keep("coupled_2x4", ",".join(names), np.column_stack([rows[name] for name in names]))


@matplotlib.rc_context(plotting.STYLE)
def draw_coupled() -> None:
    ours, theirs = table("coupled_2x4"), tradeoff.yade("steps_2x4")
    strain = -100 * theirs["axial_strain"]
    figure = Figure((3.5, 4.2), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.4, 1])
    upper.plot(
        strain, -1e-3 * theirs["sigma_yy_top_Pa"], color=THEIRS, ls="--", label="escript + YADE"
    )
    x, y = 100 * ours["axial_strain"], 1e-3 * ours["axial_stress_Pa"]
    upper.plot(np.append(0, x), np.append(100, y), color=OURS, label="femxdem_fenicsx")
    open_ = ours["converged"] == 0
    if open_.any():
        upper.plot(x[open_], y[open_], "o", ms=3, mfc="w", mec=OURS, label="not converged")
    upper.set_ylabel("axial stress (kPa),\ncompression positive")
    upper.legend()
    number = np.rint(ours["axial_strain"] * 1e3 + 0.4999).astype(int)  # of the step of 0.1 %
    evaluations = np.bincount(number, ours["evaluations"])[1:]
    lower.bar(
        strain[1:] - 0.02, theirs["dem_sweeps"][1:], 0.04, color=THEIRS, label="escript + YADE"
    )
    lower.bar(
        0.1 * np.arange(1, len(evaluations) + 1) + 0.02, evaluations, 0.04, color=OURS,
        label="femxdem_fenicsx",
    )  # fmt: skip
    lower.set_yscale("log")
    lower.set_ylabel("evaluations of the law\nper 0.1 % of strain")
    lower.set_xlabel("axial strain (%), compression positive")
    figure.align_ylabels()
    figure.savefig(FIGURES / "coupled_2x4.png")


# One packing beside YADE


def run_element_tests() -> None:
    packing, balanced = load_packing(PACKING), PRESETS["balanced"]
    rows = tradeoff.drained(packing, balanced, 0.05)
    keep("drained", "axial_strain,stress_ratio,volumetric_strain", rows)
    rows = tradeoff.isochoric(packing, balanced, 0.05)
    keep("isochoric", "log_strain,sigma_xx_Pa,sigma_yy_Pa", rows)


@matplotlib.rc_context(plotting.STYLE)
def draw_element_tests() -> None:
    others = []
    for rate in ("1e-7", "1e-6"):
        rows = tradeoff.yade(f"drained_{rate}")
        rows = rows[-rows["axial_eng_strain"] <= 0.05]
        curve = -rows["axial_eng_strain"], rows["stress_ratio_syy_over_sxx"]
        label = f"YADE, {rate} per DEM step"
        others.append((label, *curve, np.expm1(rows["vol_log_strain"])))
    ours = table("drained")
    plotting.save_history(
        FIGURES / "drained.png",
        np.append(0, ours["axial_strain"]),
        np.append(1, ours["stress_ratio"]),
        np.append(0, ours["volumetric_strain"]),
        others,
    )
    figure = Figure((3.5, 2.4), layout="constrained")
    axes = figure.subplots()
    ours, theirs = table("isochoric"), tradeoff.yade("isochoric")
    for k, name in enumerate("xy"):
        start = theirs[f"s{name}{name}_Pa"][0]
        axes.plot(
            100 * theirs["log_strain_or_gamma"], -1e-3 * theirs[f"s{name}{name}_Pa"],
            color=THEIRS, ls="--", lw=1.1, label=None if k else "YADE",
        )  # fmt: skip
        x = 100 * np.append(0, ours["log_strain"])
        y = -1e-3 * np.append(start, ours[f"sigma_{name}{name}_Pa"])
        axes.plot(x, y, color=OURS, zorder=1.9, label=None if k else "femxdem_fenicsx")
        axes.annotate(
            f"$\\sigma_{{{name}{name}}}$", (x[25], y[25]), (0, 14 if k else -14),
            textcoords="offset points", ha="center", va="center",
        )  # fmt: skip
    axes.set_xlabel("axial strain (%, logarithmic), compression positive")
    axes.set_ylabel("stress (kPa), compression positive")
    axes.margins(x=0.0)
    axes.legend()
    figure.savefig(FIGURES / "isochoric.png")


ALL = {
    "biaxial": (run_biaxial, draw_biaxial),
    "coupled": (run_coupled, draw_coupled),
    "element_tests": (run_element_tests, draw_element_tests),
}
