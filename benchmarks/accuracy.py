"""What the settings of the micro scale cost, and how far the stress is then from a very slow run.

One packing (`tests/data/yade/packing.h5`) is compressed in 16 directions, in 20 increments of about
1e-3, and does two element tests whose curves YADE gave. Prints a table and one JSON object as its
last line; `varied` says which setting a row differs in from the preset `balanced`.
"""

import argparse
import json
import sys
from pathlib import Path
from time import process_time

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from femxdem_fenicsx.dem.accuracy import PRESETS, Accuracy  # noqa: E402
from femxdem_fenicsx.dem.element_tests import drained_biaxial  # noqa: E402
from femxdem_fenicsx.dem.files import load_packing  # noqa: E402
from femxdem_fenicsx.homogenised_law import HomogenisedLaw  # noqa: E402

YADE = ROOT / "tests" / "data" / "yade"
INCREMENTS = 20
DIRECTIONS = 16


class FromRest(HomogenisedLaw):
    """Every increment starts from grains at rest (Desrues section 2.4), not as they last flowed."""

    def commit(self):
        super().commit()
        self.response.committed.flow[:] = 0.0


def increments() -> np.ndarray:
    """F - I (16, 2, 2) of an increment: biaxial compression; every other one rotates too."""
    angle = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    c, s = np.cos(angle), np.sin(angle)
    turn = np.moveaxis(np.array([[c, -s], [s, c]]), -1, 0)
    strain = turn @ np.diag([0.8e-3, -1e-3]) @ np.swapaxes(turn, 1, 2)
    spin = 0.5e-3 * np.array([[0, -1], [1, 0]])
    return strain + (np.arange(DIRECTIONS) % 2)[:, None, None] * spin


SLOWEST = PRESETS["balanced"].but(inertial_number=3e-6, tolerance=1e-4, hold_limit=20000)


def along_paths(packing, accuracy: Accuracy, kind=HomogenisedLaw, threads: int = 1):
    """Stresses (20, 16, 2, 2) along the paths, DEM steps and CPU microseconds of an increment."""
    law = kind(packing, DIRECTIONS, accuracy, threads=threads)
    F = np.eye(2) + increments()
    started, stresses = process_time(), []
    for _ in range(INCREMENTS):
        stresses.append(law.evaluate(F))
        law.commit()
    number, seconds = INCREMENTS * DIRECTIONS, process_time() - started
    return np.array(stresses), law.tally.steps / number, 1e6 * seconds / number


def deviatoric(stress: np.ndarray) -> np.ndarray:
    """Half the difference of the principal stresses of (..., 2, 2)."""
    return np.hypot(0.5 * (stress[..., 0, 0] - stress[..., 1, 1]), stress[..., 0, 1])


def drained(packing, accuracy: Accuracy, strain: float = 0.02, kind=HomogenisedLaw) -> np.ndarray:
    """(axial strain, stress ratio, volumetric strain) of the drained test, one row per 0.1 %."""
    law = kind(packing, 1, accuracy)
    states = drained_biaxial(law, 1e5, strain, 1e-3, tolerance=3e-3)
    return np.array([(s.axial_strain, s.stress_ratio, s.volumetric_strain) for s in states])


def isochoric(packing, accuracy: Accuracy, strain: float = 0.02, kind=HomogenisedLaw) -> np.ndarray:
    """(log strain, sigma_xx, sigma_yy) at constant area, x extends, one row per 0.1 %."""
    law, step = kind(packing, 1, accuracy), 1e-3
    F, rows = np.diag(np.exp([step, -step]))[None], []
    for k in range(1, round(strain / step) + 1):
        stress = law.evaluate(F)[0]
        law.commit()
        rows.append((k * step, stress[0, 0], stress[1, 1]))
    return np.array(rows)


def yade(name: str) -> np.ndarray:
    """One of YADE's curves, columns by name."""
    return np.genfromtxt(YADE / f"{name}.csv", delimiter=",", names=True)


def against_yade(packing, accuracy: Accuracy, kind=HomogenisedLaw) -> dict:
    """Differences from YADE's curves up to 2 % strain."""
    theirs, ours = yade("drained_1e-7"), drained(packing, accuracy, kind=kind)
    ratio = np.interp(ours[:, 0], -theirs["axial_eng_strain"], theirs["stress_ratio_syy_over_sxx"])
    difference = ours[:, 1] - ratio
    theirs, ours = yade("isochoric"), isochoric(packing, accuracy, kind=kind)
    strain = theirs["log_strain_or_gamma"]
    stress = [np.interp(ours[:, 0], strain, theirs[name]) for name in ("sxx_Pa", "syy_Pa")]
    return {
        "drained_ratio_largest_difference": float(np.abs(difference).max()),
        "drained_ratio_mean_difference": float(difference.mean()),
        "isochoric_largest_error": float(
            np.abs(ours[:, 1:] - np.transpose(stress)).max() / np.abs(stress).max()
        ),
    }


def row(
    packing, varied: str, accuracy: Accuracy, reference: np.ndarray, kind=HomogenisedLaw
) -> dict:
    """One row of the result."""
    stress, steps, microseconds = along_paths(packing, accuracy, kind)
    q = deviatoric(stress).sum(0)
    bias = q / deviatoric(reference).sum(0) - 1.0
    figures = {
        "varied": varied,
        "inertial_number": accuracy.inertial_number,
        "tolerance": accuracy.tolerance,
        "rms_stress_error": float(
            np.sqrt(np.mean((stress - reference) ** 2))
            / np.mean(np.abs(np.linalg.eigvalsh(reference)))
        ),
        "deviatoric_bias": float(bias.mean()),
        "its_standard_error": float(bias.std() / np.sqrt(DIRECTIONS)),
        "dem_steps_per_increment": steps,
        "core_us_per_increment": microseconds,
        **against_yade(packing, accuracy, kind),
    }
    print(
        f"{varied:34s} rms error {figures['rms_stress_error']:7.3%}"
        f"  deviatoric {figures['deviatoric_bias']:+7.3%}"
        f" ± {figures['its_standard_error']:.3%}  {steps:7.0f} steps",
        flush=True,
    )
    return figures


def cases(quick: bool) -> list[tuple[str, Accuracy, type]]:
    """(what is varied, settings, the law)."""
    balanced = PRESETS["balanced"]
    numbers = (1e-2, 1e-3) if quick else (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)
    tolerances = (1e-1, 1e-2) if quick else (1e-1, 3e-2, 1e-2, 3e-3, 1e-3)
    limit = SLOWEST.hold_limit
    result = [(f"preset {name}", accuracy, HomogenisedLaw) for name, accuracy in PRESETS.items()]
    for number in numbers:
        accuracy = balanced.but(inertial_number=number)
        result.append((f"inertial number {number:.0e}", accuracy, HomogenisedLaw))
    for tolerance in tolerances:
        accuracy = balanced.but(tolerance=tolerance, hold_limit=limit)
        result.append((f"tolerance {tolerance:.0e}", accuracy, HomogenisedLaw))
    if not quick:
        for share in (0.4, 0.6):
            result.append((f"time step {share}", balanced.but(time_step=share), HomogenisedLaw))
        for damping in (0.1, 0.5):
            result.append((f"damping {damping}", balanced.but(damping=damping), HomogenisedLaw))
    for name in ("fast", "balanced", "reference")[: 2 if quick else 3]:
        result.append((f"preset {name}, from rest", PRESETS[name], FromRest))
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer rows, a faster reference run")
    args = parser.parse_args()
    packing = load_packing(YADE / "packing.h5")
    along_paths(packing, PRESETS["fast"])  # compiles
    slowest = SLOWEST.but(inertial_number=1e-5) if args.quick else SLOWEST
    reference, steps, _ = along_paths(packing, slowest, threads=2)
    rows = []
    if not args.quick:  # what the reference run itself is uncertain by
        rows.append(
            row(packing, "reference run at 1e-5", SLOWEST.but(inertial_number=1e-5), reference)
        )
    rows += [
        row(packing, varied, accuracy, reference, kind)
        for varied, accuracy, kind in cases(args.quick)
    ]
    result = {
        "reference": {
            "inertial_number": slowest.inertial_number,
            "tolerance": slowest.tolerance,
            "dem_steps_per_increment": steps,
        },
        "rows": rows,
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
