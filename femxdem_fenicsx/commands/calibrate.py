"""`femxdem calibrate`: contact modulus and friction for a modulus and a friction angle."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from .. import calibration, contact_arguments, terminal, writing
from ..calibration import Answer, Calibration, Laboratory, Target
from ..laboratory import Specimen
from ..plotting import COLOURS, STYLE, save
from . import common


def add(commands) -> None:
    """The subcommand into a parser's."""
    parser = commands.add_parser(
        "calibrate", help="E_c and mu for a modulus and a friction angle", description=run.__doc__
    )
    target = parser.add_argument_group("target")
    target.add_argument("--young-modulus", type=float, required=True, help="Pa, of the secant")
    target.add_argument("--secant", type=float, default=1e-3, help="axial strain of that secant")
    target.add_argument("--friction-angle", type=float, required=True, help="degrees")
    target.add_argument("--angle", choices=("peak", "critical"), default="peak")
    grains = parser.add_argument_group("packings")
    common.add_grains(grains)
    contact_arguments.add_contact_law(grains)
    common.add_density(grains)
    grains.add_argument("--pressure", type=float, default=1e5, help="Pa")
    grains.add_argument("--seeds", type=int, default=4, help="packings that are averaged over")
    parser.add_argument(
        "--strain", type=float, help="axial, of the tests  (default: 0.06, critical: 0.3)"
    )
    parser.add_argument("--answers", type=int, default=15, help="to compute at most")
    parser.add_argument("--output", type=Path, default=Path("results/calibration"))
    common.add_threads(parser)
    common.add_quiet(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Contact modulus E_c and friction mu for which packings have the modulus and the angle.

    The values found are tried once more on packings of other seeds, as many again.
    """
    target = Target(args.young_modulus, args.friction_angle, args.angle == "peak", args.secant)
    strain = args.strain or (0.06 if target.peak else 0.3)
    if not 0.002 <= strain < 0.5:
        raise ValueError(f"--strain must be in [0.002, 0.5[, got {strain}")
    if args.seeds < 1:
        raise ValueError(f"--seeds must be 1 or more, got {args.seeds}")
    preparation = {
        "grains": args.grains, "radii": common.sizes_of(args), "dim": args.dim,
        "compaction_friction": common.compaction_friction_of(args),
    }  # fmt: skip
    laboratory = Laboratory(
        target, contact_arguments.contact_law_for(args), args.pressure, strain,
        tuple(range(1, args.seeds + 1)), common.threads_of(args), preparation,
    )  # fmt: skip
    with terminal.LoadProgress(args.answers, args.quiet, "calibrating") as progress:
        done = 0

        def show(answer: Answer) -> None:
            nonlocal done
            done += 1
            progress.show(done, "  ".join(_cells(answer)))

        found = calibration.calibrate(
            laboratory.answer, target, (args.modulus, args.friction), most=args.answers,
            progress=show,
        )  # fmt: skip
    best = found.best
    others = replace(laboratory, seeds=tuple(range(args.seeds + 1, 2 * args.seeds + 1)))
    tests = others.test(best.modulus, best.friction)
    checked = calibration.answer_of(tests, best.modulus, best.friction, target)
    _write(args, found, checked, tests)
    return 0


def _cells(answer: Answer) -> tuple[str, ...]:
    return (
        f"{1e-6 * answer.modulus:.0f} MPa",
        f"{answer.friction:.3f}",
        f"{1e-6 * answer.young_modulus:.2f} ± {1e-6 * answer.young_modulus_error:.2f} MPa",
        f"{answer.friction_angle:.2f} ± {answer.friction_angle_error:.2f} degrees",
    )


def _write(args, found: Calibration, checked: Answer, tests: list[Specimen]) -> None:
    """Table, picture and files."""
    rows = [(str(k), *_cells(answer)) for k, answer in enumerate(found.answers, 1)]
    rows.append(("found", *_cells(found.best)))
    rows.append(("other seeds", *_cells(checked)))
    target = found.target
    rows.append((
        "target", "", "", f"{1e-6 * target.young_modulus:.2f} MPa",
        f"{target.friction_angle:.2f} degrees",
    ))  # fmt: skip
    names = ("", "E_c", "mu", "Young's modulus", f"{args.angle} friction angle")
    terminal.print_columns("Calibration, mean ± standard error", names, rows, args.quiet)
    writing.write_json(
        args.output / "calibration.json",
        {
            "target": asdict(target),
            "found": asdict(found.best),
            "other_seeds": asdict(checked),
            "answers": [asdict(answer) for answer in found.answers],
        },
    )
    draw(args.output / "calibration.png", found, checked, tests)


@matplotlib.rc_context(STYLE)
def draw(path: Path, found: Calibration, checked: Answer, tests: list[Specimen]) -> None:
    """The answers around the target, and the tests with the values found."""
    figure = Figure((7.0, 2.5), layout="constrained")
    modulus, angle, curves = figure.subplots(1, 3)
    target, answers = found.target, found.answers
    E_c = 1e-6 * np.array([answer.modulus for answer in answers])
    mu = np.array([answer.friction for answer in answers])
    young = 1e-6 * np.array([answer.young_modulus for answer in answers])
    young_error = 1e-6 * np.array([answer.young_modulus_error for answer in answers])
    phi = np.array([answer.friction_angle for answer in answers])
    phi_error = np.array([answer.friction_angle_error for answer in answers])
    style = {"fmt": "o", "ms": 3, "color": "0.55", "lw": 0.8}
    modulus.errorbar(E_c, young, young_error, **style)
    angle.errorbar(mu, phi, phi_error, **style)
    style = {"fmt": "o", "ms": 5, "color": COLOURS[0], "lw": 1.0, "label": "other seeds"}
    modulus.errorbar(
        1e-6 * checked.modulus, 1e-6 * checked.young_modulus, 1e-6 * checked.young_modulus_error,
        **style,
    )  # fmt: skip
    angle.errorbar(checked.friction, checked.friction_angle, checked.friction_angle_error, **style)
    modulus.axhline(1e-6 * target.young_modulus, color=COLOURS[1], ls="--", lw=1, label="target")
    angle.axhline(target.friction_angle, color=COLOURS[1], ls="--", lw=1)
    modulus.set(xlabel="contact modulus $E_c$ (MPa)", ylabel="Young's modulus (MPa)")
    name = "peak" if target.peak else "critical"
    angle.set(xlabel="contact friction $\\mu$", ylabel=f"{name} friction angle (degrees)")
    modulus.legend(fontsize="small")
    for k, made in enumerate(tests):
        strain = [100 * state.axial_strain for state in (made.initial, *made.states)]
        mobilised = [row["friction_angle_deg"] for row in made.rows]
        curves.plot(strain, mobilised, lw=0.8, color=COLOURS[k % len(COLOURS)])
    curves.axhline(target.friction_angle, color=COLOURS[1], ls="--", lw=1)
    curves.set(xlabel="axial strain (%)", ylabel="friction angle (degrees)")
    save(figure, path)
