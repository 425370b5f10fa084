"""Speed for accuracy, setting by setting: of a packing, and of a small coupled biaxial test.

The packing is `tests/data/yade/packing.h5` and four more of the same grains (`femxdem tradeoff`
does the micro scale for any packing); it also does two element tests whose curves YADE gave. Prints
tables and one JSON object as its last line.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from mpi4py import MPI
from scipy.integrate import trapezoid

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "demos")]
import biaxial  # noqa: E402

from femxdem_fenicsx import tradeoff  # noqa: E402
from femxdem_fenicsx.arguments import packing_for  # noqa: E402
from femxdem_fenicsx.commands.tradeoff import show_critical, tell, write  # noqa: E402
from femxdem_fenicsx.dem.accuracy import PRESETS, Accuracy  # noqa: E402
from femxdem_fenicsx.dem.element_tests import drained_biaxial  # noqa: E402
from femxdem_fenicsx.dem.files import load_packing, save_packing  # noqa: E402
from femxdem_fenicsx.dem.packing import Packing  # noqa: E402
from femxdem_fenicsx.homogenised_law import HomogenisedLaw  # noqa: E402

YADE = ROOT / "tests" / "data" / "yade"
#: YADE's and others of its grains: an error below their scatter does not matter.
PACKINGS = 5
#: At the critical state: disks under 170 to 250 kPa have it.
VOID_RATIO = 0.222


# One packing beside YADE


def drained(packing, accuracy: Accuracy, strain: float = 0.02) -> np.ndarray:
    """(axial strain, stress ratio, volumetric strain) of the drained test, one row per 0.1 %."""
    law = HomogenisedLaw(packing, 1, accuracy)
    states = drained_biaxial(law, 1e5, strain, 1e-3, tolerance=3e-3)
    return np.array([(s.axial_strain, s.stress_ratio, s.volumetric_strain) for s in states])


def isochoric(packing, accuracy: Accuracy, strain: float = 0.02) -> np.ndarray:
    """(log strain, sigma_xx, sigma_yy) at constant area, x extends, one row per 0.1 %."""
    law, step = HomogenisedLaw(packing, 1, accuracy), 1e-3
    F, rows = np.diag(np.exp([step, -step]))[None], []
    for k in range(1, round(strain / step) + 1):
        stress = law.evaluate(F)[0]
        law.commit()
        rows.append((k * step, stress[0, 0], stress[1, 1]))
    return np.array(rows)


def yade(name: str) -> np.ndarray:
    """One of YADE's curves, columns by name."""
    return np.genfromtxt(YADE / f"{name}.csv", delimiter=",", names=True)


def against_yade(packing, accuracy: Accuracy) -> dict:
    """Differences from YADE's curves up to 2 % strain."""
    theirs, ours = yade("drained_1e-7"), drained(packing, accuracy)
    ratio = np.interp(ours[:, 0], -theirs["axial_eng_strain"], theirs["stress_ratio_syy_over_sxx"])
    difference = ours[:, 1] - ratio
    theirs, ours = yade("isochoric"), isochoric(packing, accuracy)
    strain = theirs["log_strain_or_gamma"]
    stress = [np.interp(ours[:, 0], strain, theirs[name]) for name in ("sxx_Pa", "syy_Pa")]
    return {
        "drained_ratio_largest_difference": float(np.abs(difference).max()),
        "drained_ratio_mean_difference": float(difference.mean()),
        "isochoric_largest_error": float(
            np.abs(ours[:, 1:] - np.transpose(stress)).max() / np.abs(stress).max()
        ),
    }


# The coupled test


def scenes(quick: bool) -> list[tuple[str, str, list[str]]]:
    """(setting, value, words behind the base's): one macro setting at a time, the base's first."""
    result = [("element, points", "Q8 2x2", [])]
    for name, points in (("Q4", "2x2"), ("Q8", "3x3"), ("T6", "3"))[: 1 if quick else 3]:
        words = ["--element", name, "--points", points]
        result.append(("element, points", f"{name} {points}", words))
    result.append(("load step", "1e-3", []))
    for step in ("2e-3", "4e-3") if quick else ("5e-4", "2e-3", "4e-3"):
        result.append(("load step", step, ["--step", step]))
    result.append(("tolerance on forces", "1e-2", []))
    for tolerance in ("1e-1",) if quick else ("1e-3", "3e-2", "1e-1"):
        result.append(("tolerance on forces", tolerance, ["--tolerance", tolerance]))
    result.append(("tangent operator", "PSTLO-secant", []))
    for name in ("UKO",) if quick else ("UKO", "PSTLO", "CTO"):
        result.append(("tangent operator", name, ["--operator", name]))
    newton = ["-femxdem_snes_type", "newtonls"]
    result += [("matrix", "a new one in each solve", []), ("matrix", "in each iteration", newton)]
    finite = ["--formulation", "finite"]
    result += [("formulation", "small", []), ("formulation", "finite", finite)]
    second = ["--gradient", "second", "--second-gradient-modulus", "10"]
    result += [("gradient", "first", []), ("gradient", "second", second)]
    result.append(("preset of the packings", "balanced", []))
    for name in PRESETS:
        if name != "balanced":
            result.append(("preset of the packings", name, ["--accuracy", name]))
    return result


@dataclass(frozen=True)
class Coupled:
    """What the 2 x 4 biaxial test gave for each packing, and what it cost in the mean.

    curves: (axial strain, stress ratio, void ratio) by packing, from the beginning on.
    cost: evaluations, steps not converged, DEM steps, seconds; and how many paths ended early.
    """

    curves: list[np.ndarray]
    cost: dict[str, float]


def coupled(words: list[str], strain: float, packings: Sequence[Path]) -> Coupled:
    """The test with each of the packings, in files."""
    from petsc4py import PETSc

    petsc = words if words and words[0].startswith("-femxdem") else []
    for name, value in zip(petsc[::2], petsc[1::2], strict=True):
        PETSc.Options()[name.lstrip("-")] = value
    runs = [_coupled([] if petsc else words, strain, packing) for packing in packings]
    for name in petsc[::2]:
        PETSc.Options().delValue(name.lstrip("-"))
    curves, costs = zip(*runs, strict=True)
    cost = {name: float(np.mean([each[name] for each in costs])) for name in costs[0]}
    cost["ended_early"] = round(len(packings) * cost["ended_early"])
    return Coupled(list(curves), cost)


def _coupled(words: list[str], strain: float, packing: Path) -> tuple[np.ndarray, dict]:
    with tempfile.TemporaryDirectory() as folder:
        base = ["--packing", str(packing), "--element", "Q8", "--mesh", "2", "4",
                "--formulation", "small", "--strain", str(strain), "--output", folder]  # fmt: skip
        args = biaxial.arguments().parse_args([*base, "--quiet", *words])
        specimen = biaxial.specimen_for(args, packing_for(args, MPI.COMM_WORLD, 2), MPI.COMM_WORLD)
        start = (0.0, 1.0, float(specimen.law.void_ratio.mean()))
        started = perf_counter()
        run = biaxial.compress(specimen, args)
        seconds = perf_counter() - started
    rows = [(r["axial_strain"], r["stress_ratio"], r["void_ratio"]) for r in run.rows]
    return np.array([start, *rows]), {
        "evaluations": run.outcome.evaluations,
        "not_converged": run.outcome.not_converged,
        "dem_steps": specimen.law.tally.steps,
        "seconds": seconds,
        "ended_early": bool(run.outcome.lost_controllability),
    }


#: Errors of a curve: of the largest and the last stress ratio, the area below, root mean square.
ERRORS = ("peak_error", "last_error", "area_error", "curve_error", "void_ratio_error")


def against(curve: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Errors of a curve, at its own strains."""
    strain = curve[:, 0]
    theirs = [np.interp(strain, reference[:, 0], reference[:, k]) for k in (1, 2)]
    difference = curve[:, 1] - theirs[0]
    return {
        "peak_error": float(curve[:, 1].max() / theirs[0].max() - 1.0),
        "last_error": float(difference[-1] / theirs[0][-1]),
        "area_error": float(trapezoid(difference, strain) / trapezoid(theirs[0], strain)),
        "curve_error": float(np.sqrt((difference**2).mean()) / theirs[0].mean()),
        "void_ratio_error": float(np.abs(curve[:, 2] - theirs[1]).max()),
    }


def scatter(curves: Sequence[np.ndarray]) -> float:
    """Standard deviation of the stress ratio between packings, over its mean."""
    strain = max(curves, key=len)[:, 0]
    ratios = np.array([np.interp(strain, curve[:, 0], curve[:, 1]) for curve in curves])
    return float(np.sqrt(ratios.var(0, ddof=1).mean()) / ratios.mean())


def macro(packings: Sequence[Packing], quick: bool) -> dict[str, object]:
    """Rows of the coupled study, the scatter of its packings, and one sentence per setting.

    Errors are root mean squares over the packings, of differences from the same packing's run with
    small steps, a sharp tolerance and slow grains; those with a sign are means.
    """
    strain = 0.01 if quick else 0.02
    finest = ["--step", "5e-4", "--tolerance", "1e-3", "--accuracy", "reference"]
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder, f"{k}.h5") for k in range(len(packings))]
        for path, packing in zip(files, packings, strict=True):
            save_packing(path, packing)
        reference = coupled(finest, strain, files).curves
        rows, base = [], coupled([], strain, files)
        for setting, value, words in scenes(quick):
            found = coupled(words, strain, files) if words else base
            pairs = zip(found.curves, reference, strict=True)
            errors = [against(*pair) for pair in pairs]
            rows.append({"setting": setting, "value": value, **summary(errors), **found.cost})
            show(rows[-1])
    apart = scatter(reference)
    return {
        "macro": rows,
        "macro_scatter": apart,
        "macro_sentences": tradeoff.sentences(rows, apart, "curve_error"),
    }


def summary(errors: Sequence[dict[str, float]]) -> dict[str, object]:
    """Of the errors of all packings: those with a sign in the mean, and the spread."""
    values = {name: np.array([each[name] for each in errors]) for name in ERRORS}
    result: dict[str, object] = {"same_model": True}
    for name, each in values.items():
        signed = name in ("peak_error", "last_error", "area_error")
        result[name] = float(each.mean() if signed else np.sqrt((each**2).mean()))
        result[f"{name}_spread"] = float(each.std(ddof=1))
    return result


def show(row: dict[str, object]) -> None:
    """A row of the coupled study, as soon as it is there."""
    print(
        f"{row['setting']:23} {row['value']:>24} {row['evaluations']:6.1f} evaluations"
        f" {row['dem_steps']:9.0f} steps  curve {row['curve_error']:6.2%}"
        f" ± {row['curve_error_spread']:.2%}  peak {row['peak_error']:+.2%}"
        f"  {row['seconds']:.1f} s",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer values, less strain")
    parser.add_argument("--output", type=Path, help="folder for table, picture and summary")
    args = parser.parse_args()
    packing = load_packing(YADE / "packing.h5")
    packings = tradeoff.family(packing, PACKINGS)
    result = tradeoff.study(packings, tradeoff.Path(), args.quick, 2, tell)
    print(*result["sentences"], sep="\n", flush=True)
    for name, accuracy in PRESETS.items():
        result["presets"][name]["against_yade"] = against_yade(packing, accuracy)
    result["critical"] = tradeoff.critical(packing, args.quick, None, VOID_RATIO, 2)
    show_critical(result["critical"])
    result |= macro(packings, args.quick)
    print(*result["macro_sentences"], sep="\n", flush=True)
    if args.output is not None:
        write(args.output, result)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
