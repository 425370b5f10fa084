"""Speed for accuracy, setting by setting: of a packing, and of a small coupled biaxial test.

The packing is `tests/data/yade/packing.h5` and four more of the same grains (`femxdem tradeoff`
does the same for any packing); it also does two element tests whose curves YADE gave. Prints tables
and one JSON object as its last line.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np
from mpi4py import MPI

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "demos")]
import biaxial  # noqa: E402

from femxdem_fenicsx import tradeoff  # noqa: E402
from femxdem_fenicsx.arguments import packing_for  # noqa: E402
from femxdem_fenicsx.commands.tradeoff import tell, write  # noqa: E402
from femxdem_fenicsx.dem.accuracy import PRESETS, Accuracy  # noqa: E402
from femxdem_fenicsx.dem.element_tests import drained_biaxial  # noqa: E402
from femxdem_fenicsx.dem.files import load_packing  # noqa: E402
from femxdem_fenicsx.homogenised_law import HomogenisedLaw  # noqa: E402

YADE = ROOT / "tests" / "data" / "yade"


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
    result.append(("preset", "balanced", []))
    result += [("preset", name, ["--accuracy", name]) for name in PRESETS if name != "balanced"]
    return result


def coupled(words: list[str], strain: float) -> dict[str, object]:
    """The curve of the 2 x 4 biaxial test and what it cost."""
    from petsc4py import PETSc

    petsc = words if words and words[0].startswith("-femxdem") else []
    for name, value in zip(petsc[::2], petsc[1::2], strict=True):
        PETSc.Options()[name.lstrip("-")] = value
    with tempfile.TemporaryDirectory() as folder:
        base = ["--packing", str(YADE / "packing.h5"), "--element", "Q8", "--mesh", "2", "4",
                "--formulation", "small", "--strain", str(strain), "--output", folder]  # fmt: skip
        args = biaxial.arguments().parse_args([*base, "--quiet", *([] if petsc else words)])
        specimen = biaxial.specimen_for(args, packing_for(args, MPI.COMM_WORLD, 2), MPI.COMM_WORLD)
        started = perf_counter()
        run = biaxial.compress(specimen, args)
        seconds = perf_counter() - started
    for name in petsc[::2]:
        PETSc.Options().delValue(name.lstrip("-"))
    tally = specimen.law.tally
    return {
        "curve": np.array(
            [(r["axial_strain"], r["stress_ratio"], r["void_ratio"]) for r in run.rows]
        ),
        "evaluations": run.outcome.evaluations,
        "not_converged": run.outcome.not_converged,
        "dem_steps": tally.steps,
        "seconds": seconds,
        "ended_early": run.outcome.lost_controllability,
    }


def against(curve: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Errors of peak, last value, whole curve and void ratio, at the strains of the curve."""
    strain = curve[:, 0]
    theirs = [np.interp(strain, reference[:, 0], reference[:, k]) for k in (1, 2)]
    difference = curve[:, 1] - theirs[0]
    return {
        "peak_error": float(curve[:, 1].max() / reference[:, 1].max() - 1.0),
        "last_error": float(difference[-1] / theirs[0][-1]),
        "curve_error": float(np.sqrt((difference**2).mean()) / theirs[0].mean()),
        "void_ratio_error": float(np.abs(curve[:, 2] - theirs[1]).max()),
    }


def macro(quick: bool) -> list[dict[str, object]]:
    """Rows of the coupled study; errors against small steps, a sharp tolerance, slow grains."""
    strain = 0.01 if quick else 0.02
    finest = ["--step", "5e-4", "--tolerance", "1e-3", "--accuracy", "reference"]
    reference = coupled(finest, strain)["curve"]
    rows, base = [], coupled([], strain)
    for setting, value, words in scenes(quick):
        found = coupled(words, strain) if words else dict(base)
        row = {
            "setting": setting,
            "value": value,
            **against(found.pop("curve"), reference),
            **found,
        }
        rows.append(row)
        print(
            f"{setting:20} {value:>24} {row['evaluations']:5d} evaluations"
            f" {row['dem_steps']:9d} steps  curve {row['curve_error']:6.2%}"
            f"  peak {row['peak_error']:+.2%}  {row['seconds']:.1f} s",
            flush=True,
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer values, less strain")
    parser.add_argument("--output", type=Path, help="folder for table, picture and summary")
    args = parser.parse_args()
    packing = load_packing(YADE / "packing.h5")
    result = tradeoff.study(packing, tradeoff.Path(), 5, args.quick, 2, tell)
    print(*result["sentences"], sep="\n", flush=True)
    for name, accuracy in PRESETS.items():
        result["presets"][name]["against_yade"] = against_yade(packing, accuracy)
    result["macro"] = macro(args.quick)
    if args.output is not None:
        write(args.output, result)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
