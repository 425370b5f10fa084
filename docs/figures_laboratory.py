"""The laboratory (docs/laboratory.md)."""

import json
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from figures_common import FIGURES, OURS, RESULTS, THEIRS, THIRD, femxdem, keep_picture, python
from matplotlib.figure import Figure

from femxdem_fenicsx import plotting


def run_laboratory() -> None:
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)

        def test(name: str, packing: str, *words: object) -> None:
            femxdem(
                "element-test", name, "--packing", work / packing, "--output", work, "--quiet",
                *words,
            )  # fmt: skip

        def prepare(name: str, *words: object) -> None:
            femxdem("packing", "prepare", "--output", work / name, "--quiet", *words)

        prepare("sand.h5")
        prepare("loose.h5", "--void-ratio", 0.223, "--seed", 4)
        prepare("medium.h5", "--void-ratio", 0.209, "--seed", 5)
        femxdem("packing", "plot", work / "sand.h5")
        keep_picture(work / "sand.png", "lab_packing")
        test("biaxial", "sand.h5", "--strain", 0.3)
        keep_picture(work / "biaxial.png", "lab_biaxial")
        prepare("balls.h5", "--dim", 3, "--seed", 11)
        test("triaxial", "balls.h5", "--strain", 0.1)
        keep_picture(work / "triaxial.png", "lab_triaxial")
        test("cyclic-shear", "loose.h5", "--cycles", 25)
        keep_picture(work / "cyclic-shear.png", "lab_liquefaction")
        words = ("--shear-stress", 3e4, "--cycles", 40, "--largest", 0.06)
        test("cyclic-shear", "medium.h5", *words)
        keep_picture(work / "cyclic-shear.png", "lab_mobility")
        test("probes", "sand.h5")
        keep_picture(work / "probes.png", "lab_probes")
        test("biaxial", "sand.h5", "--strain", 0.005)
        test("probes", "biaxial-end.h5")
        keep_picture(work / "probes.png", "lab_probes_loaded")
        words = ("--young-modulus", 4e7, "--friction-angle", 26, "--seeds", 12)
        femxdem("calibrate", *words, "--quiet", "--output", work)
        keep_picture(work / "calibration.png", "lab_calibration")


def draw_laboratory() -> None:
    """The commands have drawn already."""


def run_representativity() -> None:
    """About 45 minutes of one core, but for the rows that are there already."""
    folder = RESULTS / "representativity"
    femxdem("packing", "representativity", "--output", folder, "--quiet")
    for name in ("disks", "spheres", "structure"):
        keep_picture(folder / f"{name}.png", f"lab_{name}")
    (FIGURES / "representativity.csv").write_text((folder / "summary.csv").read_text())


def draw_representativity() -> None:
    """The command has drawn already."""


def run_friction() -> None:
    output = python("benchmarks/friction_table.py").splitlines()[-1]
    (FIGURES / "friction.json").write_text(json.dumps(json.loads(output), indent=1) + "\n")


@matplotlib.rc_context(plotting.STYLE)
def draw_friction() -> None:
    rows = json.loads((FIGURES / "friction.json").read_text())["rows"]
    mu = [row["friction"] for row in rows]
    figure = Figure((5.6, 2.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, label, colour in (
        ("peak_friction_angle", "peak friction angle", OURS),
        ("critical_friction_angle", "critical friction angle", THEIRS),
        ("dilatancy_angle", "dilatancy angle at peak", THIRD),
    ):
        errors = [row[f"{name}_error"] for row in rows]
        left.errorbar(
            mu, [row[name] for row in rows], errors, fmt="o-", ms=3, lw=1, capsize=2,
            color=colour, label=label,
        )  # fmt: skip
    left.set(xlabel="contact friction $\\mu$", ylabel="angle (degrees)")
    left.legend(fontsize="small")
    for name, label, colour in (
        ("void_ratio", "at the beginning", "0.5"),
        ("critical_void_ratio", "critical", OURS),
    ):
        errors = [row[f"{name}_error"] for row in rows]
        right.errorbar(
            mu, [row[name] for row in rows], errors, fmt="o-", ms=3, lw=1, capsize=2,
            color=colour, label=label,
        )  # fmt: skip
    right.plot(np.tan(0.5), 0.23, "*", ms=9, color=THEIRS, label="Guo–Zhao")
    right.set(xlabel="contact friction $\\mu$", ylabel="void ratio")
    right.legend(fontsize="small")
    figure.savefig(FIGURES / "lab_friction.png")


ALL = {
    "laboratory": (run_laboratory, draw_laboratory),
    "representativity": (run_representativity, draw_representativity),
    "friction": (run_friction, draw_friction),
}
