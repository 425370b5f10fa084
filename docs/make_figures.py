"""Draw the pictures of the documentation: runs the scenes, keeps their numbers, draws.

Writes `docs/figures/*.png` and, beside them, the small tables that they are drawn from. With
`--redraw` it draws from the tables that are there and runs nothing. Names choose figures.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures"
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]
import tradeoff  # noqa: E402

from femxdem_fenicsx import lab_plots, plotting  # noqa: E402
from femxdem_fenicsx.dem.accuracy import PRESETS  # noqa: E402
from femxdem_fenicsx.dem.files import load_packing  # noqa: E402

OURS, THEIRS, THIRD = plotting.COLOURS[:3]
#: The packing of the demo in the pictures.
PACKING = str(tradeoff.YADE / "packing.h5")


def python(script: str, *arguments: str) -> str:
    """Run a script of this repository; its output. A demo whose load path ends early is fine."""
    done = subprocess.run(
        [sys.executable, str(ROOT / script), *arguments], stdout=subprocess.PIPE, text=True
    )
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{script} ended with exit code {done.returncode}")
    return done.stdout


def table(name: str) -> np.ndarray:
    """One of the tables beside the figures, columns by name."""
    return np.genfromtxt(FIGURES / f"{name}.csv", delimiter=",", names=True)


def keep(name: str, columns: str, rows: np.ndarray) -> None:
    """Write a table beside the figures."""
    np.savetxt(
        FIGURES / f"{name}.csv", rows, fmt="%.6g", delimiter=",", header=columns, comments=""
    )


# The demo, as `make biaxial` runs it but with YADE's packing


def run_biaxial() -> None:
    with tempfile.TemporaryDirectory() as folder:
        summary = python("demos/biaxial.py", "--packing", PACKING, "--output", folder)
        for name in ("fields", "history", "force_chains"):
            with Image.open(Path(folder) / f"{name}.png") as picture:  # 256 colours: smaller files
                picture.convert("RGB").quantize(256).save(FIGURES / f"biaxial_{name}.png")
    (FIGURES / "biaxial.txt").write_text(summary)


def draw_biaxial() -> None:
    """The demo has drawn already."""


# The coupled test beside escript + YADE


def run_coupled() -> None:
    with tempfile.TemporaryDirectory() as folder:
        python(
            "demos/biaxial.py", "--quiet", "--output", folder, "--formulation", "small",
            "--packing", str(tradeoff.YADE / "packing.h5"), "--element", "Q8",
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
    packing, balanced = load_packing(tradeoff.YADE / "packing.h5"), PRESETS["balanced"]
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


# Error against cost of the micro scale


def run_tradeoff() -> None:
    with tempfile.TemporaryDirectory() as folder:
        python("benchmarks/tradeoff.py", "--output", folder)
        (FIGURES / "tradeoff.json").write_text((Path(folder) / "tradeoff.json").read_text())


def draw_tradeoff() -> None:
    result = json.loads((FIGURES / "tradeoff.json").read_text())
    lab_plots.save_tradeoff(FIGURES / "tradeoff.png", result["sweep"], result["scatter"])
    (FIGURES / "tradeoff.md").write_text("\n".join(tradeoff_tables(result)) + "\n")


def tradeoff_tables(result: dict) -> list[str]:
    """The tables of docs/accuracy.md, as Markdown."""
    lines = [
        "| setting | value | DEM steps | rms error of the stress | error of the peak |"
        " of the drained curve | of its void ratio | CPU µs |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in result["sweep"]:
        lines.append(
            f"| {row['setting']} | {row['value']} | {row['dem_steps']:.0f} |"
            f" {row['rms_stress_error']:.2%} ± {row['spread_over_packings']:.2%} |"
            f" {row['peak_error']:+.1%} | {row['curve_error']:.1%} |"
            f" {row['void_ratio_error']:.4f} | {1e6 * row['seconds']:.0f} |"
        )
    lines += [
        "", "| setting | value | evaluations | 1000 DEM steps | error of the curve | of the peak |"
        " at the end | s |", "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in result["macro"]:
        lines.append(
            f"| {row['setting']} | {row['value']} | {row['evaluations']} |"
            f" {1e-3 * row['dem_steps']:.0f} | {row['curve_error']:.2%} |"
            f" {row['peak_error']:+.2%} | {row['last_error']:+.2%} | {row['seconds']:.1f} |"
        )
    return [*lines, "", *(f"- {sentence}" for sentence in result["sentences"])]


# Bands of a softening law, and of grains, on two meshes


def softening_fields() -> dict[str, np.ndarray]:
    """(points, x y and deviatoric strain) by gradient and columns."""
    from petsc4py import PETSc

    from tests.forms.test_localisation import compressed

    PETSc.Options()["femxdem_snes_type"] = "newtonls"
    fields = {}
    for gradient, modulus in (("first", None), ("second", 0.006)):
        for columns in (8, 16):
            curve, x, strain, _ = compressed(columns, modulus, 0.016, 0.002)
            fields[f"{gradient}_{columns}"] = np.column_stack([x, strain])
            fields[f"{gradient}_{columns}_curve"] = curve.T
    return fields


def run_second_gradient() -> None:
    np.savez_compressed(FIGURES / "second_gradient.npz", **softening_fields())


@matplotlib.rc_context(plotting.STYLE)
def draw_second_gradient() -> None:
    fields = np.load(FIGURES / "second_gradient.npz")
    figure = Figure((7.0, 3.2), layout="constrained")
    *maps, right = figure.subplots(1, 5, width_ratios=[1, 1, 1, 1, 2.2])
    cases = [(g, c) for g in ("first", "second") for c in (8, 16)]
    for axes, (gradient, columns) in zip(maps, cases, strict=True):
        x, y, strain = fields[f"{gradient}_{columns}"].T
        axes.tripcolor(x, y, 100 * strain, vmin=0, vmax=15, shading="gouraud", rasterized=True)
        axes.set(aspect="equal", xticks=[], yticks=[])
        axes.set_title(f"{gradient}\n{columns} x {2 * columns}", fontsize="small")
    for gradient, colour in (("first", THEIRS), ("second", OURS)):
        for columns, style in ((8, "--"), (16, "-")):
            load, force = fields[f"{gradient}_{columns}_curve"].T
            label = f"{gradient}, {columns} x {2 * columns}"
            right.plot(100 * load, -force, color=colour, ls=style, label=label)
    right.set_xlabel("axial strain (%), compression positive")
    right.set_ylabel("force on the plate (N/m), compression positive")
    right.legend(fontsize="small")
    figure.savefig(FIGURES / "second_gradient.png")


# Argilaga's study of the tangent operators


def run_operators() -> None:
    output = python("benchmarks/operators.py", "--quick").splitlines()[-1]
    rounded = json.loads(output, parse_float=lambda text: float(f"{float(text):.4g}"))
    (FIGURES / "operators.json").write_text(json.dumps(rounded) + "\n")


#: Line styles of the operators by kind: perturbed, affine, elastic.
KINDS = {
    "CTO": (THEIRS, "-"), "AEO": (THEIRS, "--"), "UKO": ("0.55", "-"), "UCKO": ("0.55", "--"),
    "UCKO-2DOF": ("0.55", ":"), "KAO": ("0.25", "-."), "DEMQO": (THIRD, "--"), "PSTLO": (OURS, "-"),
    "PSTLO-secant": (OURS, "--"), "default": (OURS, "-"),
}  # fmt: skip


@matplotlib.rc_context(plotting.STYLE)
def draw_operators() -> None:
    study = json.loads((FIGURES / "operators.json").read_text())
    draw_convergence(study)
    draw_cost(study)
    draw_spectra(study)


def draw_convergence(study: dict) -> None:
    """Argilaga's fig. 6."""
    figure = Figure((7.0, 3.0), layout="constrained")
    for axes, state in zip(figure.subplots(1, 2, sharey=True), ("start", "after"), strict=True):
        for name, ratios in study["states"][state]["curves"].items():
            colour, style = KINDS[name]
            axes.semilogy(ratios, color=colour, ls=style, label=name)
        axes.axhline(1e-2, color="0.8", lw=0.8, zorder=0)
        axes.set_xlabel("iteration")
        axes.set_title(f"from {100 * study['states'][state]['strain']:g} % strain")
    figure.axes[0].set_ylabel("FNORM/RNORM")
    figure.axes[1].legend(fontsize="small", ncols=2)
    figure.savefig(FIGURES / "operators_convergence.png")


def draw_cost(study: dict) -> None:
    """Argilaga's fig. 7, with evaluations beside iterations."""
    rows = {name: row for name, row in study["operators"].items() if row["strain_at_end"] > 0.0199}
    place = np.arange(len(rows))
    figure = Figure((7.0, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for shift, when, label in ((-0.2, "pre", "before the peak"), (0.2, "post", "after it")):
        values = [row[f"evaluations_{when}"] for row in rows.values()]
        left.bar(place + shift, values, 0.4, color=OURS if shift < 0 else THEIRS, label=label)
    left.set_ylabel("evaluations of the law per step")
    left.legend(fontsize="small")
    timed = {name: row for name, row in rows.items() if row["wall_s"] is not None}
    tangents = np.array([row["tangent_s"] for row in timed.values()])
    total = np.array([row["wall_s"] for row in timed.values()])
    right.bar(list(timed), total - tangents, 0.6, color="0.7", label="evaluations and FEM")
    right.bar(list(timed), tangents, 0.6, total - tangents, color=THIRD, label="tangents")
    right.set_ylabel("wall-clock to 2 %, s")
    right.legend(fontsize="small")
    left.set_xticks(place, rows, rotation=60, ha="right")
    right.set_xticks(range(len(timed)), timed, rotation=60, ha="right")
    for axes in (left, right):
        axes.set_ylim(0, 1.3 * axes.get_ylim()[1])  # room for the legend
    figure.savefig(FIGURES / "operators_cost.png")


def draw_spectra(study: dict) -> None:
    """Eigenvalues of K^-1 J; 1 is perfect."""
    figure = Figure((7.0, 2.8), layout="constrained")
    for axes, state in zip(figure.subplots(1, 2, sharey=True), ("before", "after"), strict=True):
        spectra = study["states"][state]["spectra"]
        for place, (name, (real, _)) in enumerate(spectra.items()):
            axes.plot(np.full(len(real), place), real, "_", ms=9, color=KINDS[name][0], alpha=0.6)
        axes.axhline(1.0, color="0.8", lw=0.8, zorder=0)
        axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
        axes.set_ylim(-1.0, 2.0)
        axes.set_xticks(range(len(spectra)), spectra, rotation=60, ha="right")
        axes.set_title(f"at {100 * study['states'][state]['strain']:g} % strain")
    figure.axes[0].set_ylabel("eigenvalues of $K^{-1}J$, real part")
    figure.savefig(FIGURES / "operators_spectra.png")


# The laboratory


def femxdem(*arguments: object) -> str:
    """A command of the laboratory; its output. A test that ends early is fine."""
    command = [sys.executable, "-m", "femxdem_fenicsx.cli", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    if done.returncode not in (0, 3):
        raise RuntimeError(f"femxdem {arguments} ended with exit code {done.returncode}")
    return done.stdout


def keep_picture(source: Path, name: str) -> None:
    """Copy a picture with 256 colours: smaller files."""
    with Image.open(source) as picture:
        picture.convert("RGB").quantize(256).save(FIGURES / f"{name}.png")


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
        words = ("--young-modulus", 4e7, "--friction-angle", 26, "--quiet", "--output", work)
        femxdem("calibrate", *words)
        keep_picture(work / "calibration.png", "lab_calibration")


def draw_laboratory() -> None:
    """The commands have drawn already."""


def run_representativity() -> None:
    """About 45 minutes of one core, but for the rows that are there already."""
    folder = ROOT / "results" / "representativity"
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


def run_localisation() -> None:
    from figures_localisation import run

    run(python)


def draw_localisation() -> None:
    from figures_localisation import draw

    draw()


def run_bands() -> None:
    import figures_bands

    figures_bands.run(python)


def draw_bands() -> None:
    import figures_bands

    figures_bands.draw()


NAMES = (
    "tradeoff", "element_tests", "coupled", "biaxial", "operators", "laboratory",
    "representativity", "friction", "second_gradient", "bands", "localisation",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"{', '.join(NAMES)} (default: all)")
    parser.add_argument("--redraw", action="store_true", help="run nothing")
    args = parser.parse_args()
    unknown = set(args.names) - set(NAMES)
    if unknown:
        parser.error(f"unknown figure {', '.join(sorted(unknown))}; choose from {', '.join(NAMES)}")
    FIGURES.mkdir(parents=True, exist_ok=True)
    for name in args.names or NAMES:
        print(name, flush=True)
        if not args.redraw:
            globals()[f"run_{name}"]()
        globals()[f"draw_{name}"]()


if __name__ == "__main__":
    main()
