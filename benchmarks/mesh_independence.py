"""Shear bands of `demos/biaxial.py` on finer and finer meshes, first and second gradient.

Desrues section 4.5 and eq. 46: with the second gradient the width of a band does not depend on
the mesh, and goes with the square root of D. A dent in one side gives the band its place. The
width is measured behind every step (`femxdem_fenicsx.shear_band`), so that runs can be compared at
the same axial strain, or at the same strain in the band. Prints one JSON object as its last line;
each finished run is kept in the output folder and not run again, a stopped one goes on from its
last checkpoint.
"""

import argparse
import json
import sys
from pathlib import Path
from time import perf_counter

import numpy as np
from mpi4py import MPI

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "demos")]
import biaxial  # noqa: E402

from femxdem_fenicsx import arguments, compression, script, shear_band  # noqa: E402
from femxdem_fenicsx.checkpoint import complete  # noqa: E402
from femxdem_fenicsx.collective import together  # noqa: E402
from femxdem_fenicsx.dem.files import save_packing  # noqa: E402
from femxdem_fenicsx.fem.stepping import LoadStepping, StepRecord  # noqa: E402
from femxdem_fenicsx.load_path import Run, Scene, follow  # noqa: E402

#: Columns of elements, D in N (None: first gradient), and the axial strain to reach: a wide band
#: takes longer to strain as much as a narrow one.
FULL = [
    (8, 10.0, 0.04), (16, 10.0, 0.04), (32, 10.0, 0.04), (16, 3.2, 0.025), (32, 3.2, 0.025),
    (16, 1.0, 0.02), (32, 1.0, 0.02), (8, None, 0.02), (16, None, 0.0165), (32, None, 0.0155),
]  # fmt: skip
QUICK = [
    (8, 10.0, 0.04), (16, 10.0, 0.04), (16, 3.2, 0.025), (16, 1.0, 0.02),
    (8, None, 0.02), (16, None, 0.0165),
]  # fmt: skip
SCENE = {"--element": "Q8", "--imperfection": 0.02, "--step": 5e-4, "--tolerance": 2e-2,
         "--looser-tolerance": 0.1, "--max-iterations": 12}  # fmt: skip
#: Of a band, in history.csv; zero where there is none, and before this axial strain.
BAND = ("band_width", "band_angle", "band_strain", "band_contrast")
FORMING = 0.01


def main(comm: MPI.Comm) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--grains", type=int, help="per point  (default: 400, quick 100)")
    parser.add_argument("--quick", action="store_true", help="few grains, two meshes")
    parser.add_argument(
        "--runs",
        nargs="+",
        type=case,
        metavar="COLUMNS:D:STRAIN",
        help="these instead, as 32:10:0.04 or 16:first:0.02",
    )
    parser.add_argument("--accuracy", help="(default: balanced, quick fast)")
    parser.add_argument("--path-following", default="indirect", help="none, crossing or indirect")
    parser.add_argument("--micro-strain", default="linear", help="linear or quadratic")
    parser.add_argument("--output", type=Path, help="folder of runs  (default: results/...)")
    args = script.parse(parser, comm)
    grains = args.grains or (100 if args.quick else 400)
    mode = "quick" if args.quick else "full"
    folder = args.output or ROOT / "results" / f"mesh_independence_{mode}"
    packing = together(comm, packing_of, comm, folder / "packing.h5", grains)
    runs = []
    for columns, modulus, strain in args.runs or (QUICK if args.quick else FULL):
        path = folder / name(2 * columns**2, modulus, args.micro_strain) / "run.json"
        if comm.bcast(path.exists()):
            runs.append(json.loads(path.read_text()))
            continue
        options = {
            **SCENE,
            "--packing": packing,
            "--strain": strain,
            "--accuracy": args.accuracy or ("fast" if args.quick else "balanced"),
            "--path-following": args.path_following,
            "--output": path.parent,
        }
        if modulus is not None:
            options |= {"--gradient": "second", "--second-gradient-modulus": modulus}
            options |= {"--micro-strain": args.micro_strain}
        words = [str(word) for option in options.items() for word in option]
        measured, signal = compress(comm, [*words, "--mesh", str(columns), str(2 * columns)])
        if signal:
            return script.SIGNALLED + signal
        runs.append(measured)
        together(comm, save, comm, path, measured)
    if comm.rank == 0:
        whole = {"grains": grains, "runs": runs}
        print(json.dumps(whole | {"power_of_D": power(folder, runs)}))
    return 0


def packing_of(comm: MPI.Comm, path: Path, grains: int) -> Path:
    """File with the packing of all runs: the same seed need not give the same one twice."""
    if comm.rank == 0 and not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        args = biaxial.arguments().parse_args(["--grains", str(grains)])
        save_packing(path, arguments.packing_for(args, MPI.COMM_SELF, 2))
    return path


def case(word: str) -> tuple[int, float | None, float]:
    """ "16:3.2:0.025" or "16:first:0.02"."""
    columns, modulus, strain = word.split(":")
    return int(columns), None if modulus == "first" else float(modulus), float(strain)


def name(elements: int, modulus: float | None, micro_strain: str | None) -> str:
    """Of a run's folder."""
    quadratic = "_quadratic" if modulus and micro_strain == "quadratic" else ""
    return f"{elements}_{modulus or 'first'}{quadratic}"


def power(folder: Path, runs: list[dict]) -> dict | None:
    """Power of D with which widths go (eq. 46: 0.5), in the finest runs of each D.

    Narrow bands strain faster than wide ones, and a packing softens less the further it has
    strained. Compared are therefore bands of the same strain, the largest that all have had, and,
    beside that, those at the same axial strain, the last of all.
    """
    finest = {run["D"]: run for run in sorted(runs, key=lambda run: run["elements"]) if run["D"]}
    if len(finest) < 2:
        return None
    histories = [
        np.genfromtxt(
            folder / name(run["elements"], run["D"], run.get("micro_strain")) / "history.csv",
            delimiter=",",
            names=True,
        )
        for run in finest.values()
    ]
    histories = [rows[rows["band_width"] > 0] for rows in histories]
    found = {"D": list(finest)}
    for by in ("band_strain", "axial_strain"):
        common = min(rows[by].max() for rows in histories)
        widths = [rows["band_width"][np.argmax(rows[by] >= common)] for rows in histories]
        slope = np.polyfit(np.log(found["D"]), np.log(widths), 1)[0]
        found[by] = {"at": common, "widths": widths, "power": float(slope)}
    return found


def save(comm: MPI.Comm, path: Path, run: dict) -> None:
    if comm.rank == 0:
        path.write_text(json.dumps(run))
        print(json.dumps(run), flush=True)


def compress(comm: MPI.Comm, words: list[str]) -> tuple[dict, int]:
    """One run, measured, and the signal that stopped it, or 0."""
    args = biaxial.arguments().parse_args([*words, "--quiet"])
    args.resume = comm.bcast(bool(complete(arguments.checkpoint_folder(args))))
    biaxial.shared.check(args, 2, biaxial.FORMULATIONS)
    together(comm, lambda: args.output.mkdir(parents=True, exist_ok=True))
    specimen = biaxial.specimen_for(args, arguments.packing_for(args, comm, 2), comm)
    law, started = specimen.law, perf_counter()

    def row(record: StepRecord) -> dict[str, float]:
        return compression.row_of(specimen, record) | band_of(specimen, record.load)

    scene = Scene(
        specimen.problem,
        specimen.compress,
        (*compression.columns_of(law), *BAND),
        row,
        lambda: compression.fields_of(law),
        lambda row: f"strain {row['axial_strain']:.3%}  band {1e3 * row['band_width']:.1f} mm",
    )
    stepping = LoadStepping(
        args.step,
        args.step / 16,
        args.looser_tolerance,
        **arguments.PATH_FOLLOWING[args.path_following],
    )
    saving = arguments.saving_of(args, law)
    run = follow(scene, args.strain, stepping, args.output / "biaxial", True, saving)
    dem = comm.allreduce(law.tally.seconds + law.tally.tangent_seconds, MPI.MAX)
    return told(args, run, dem) | {"wall_seconds": perf_counter() - started}, run.signal


def band_of(specimen: compression.Specimen, load: float) -> dict[str, float]:
    """Width (m), angle (degrees), strain and contrast; zeros for a field without a band."""
    if load < FORMING:
        return dict.fromkeys(BAND, 0.0)
    points = specimen.points
    cells = len(points.cells)
    found = points.gather(
        points.coordinates().reshape(cells, -1, 2),
        specimen.law.deviatoric_strain.reshape(cells, -1),
    )

    def measure() -> dict[str, float] | None:
        if found is None:
            return None
        try:
            band = shear_band.measure(*(np.concatenate(list(array)) for array in found))
        except ValueError:
            return dict.fromkeys(BAND, 0.0)
        return dict(zip(BAND, (band.width, band.angle, band.strain, band.contrast), strict=True))

    return points.mesh.comm.bcast(together(points.mesh.comm, measure))


def told(args: argparse.Namespace, run: Run, dem_seconds: float) -> dict:
    """What a run has shown. Seconds are those since it was started, or resumed."""
    rows = run.rows
    peak = max(range(len(rows)), key=lambda k: rows[k]["stress_ratio"])
    after, last = rows[peak + 1 :], rows[-1]
    band = {name.removeprefix("band_"): last[name] for name in BAND} if last[BAND[0]] else None
    return {
        "elements": args.mesh[0] * args.mesh[1],
        "gradient": args.gradient,
        "D": args.second_gradient_modulus,
        "micro_strain": args.micro_strain,
        "band_width": band and band["width"],
        "band": band,
        "iterations": run.outcome.iterations,
        "evaluations": run.outcome.evaluations,
        "residual_stress_kpa": last["axial_stress_Pa"] / 1e3,
        "peak_stress_kpa": rows[peak]["axial_stress_Pa"] / 1e3,
        "strain_at_peak": rows[peak]["axial_strain"],
        "strain_at_end": run.outcome.load,
        "steps_after_peak": len(after),
        "iterations_per_0.1_percent_after_peak": per_strain(after, "iterations", rows[peak]),
        "evaluations_per_0.1_percent_after_peak": per_strain(after, "evaluations", rows[peak]),
        "not_converged_after_peak": sum(not row["converged"] for row in after),
        "moves": sum(row["moves"] for row in rows),
        "lost_work": last["lost_work_J"] / last["work_J"],
        "fem_seconds": run.solving - dem_seconds,
        "fem_share": (run.solving - dem_seconds) / run.solving,
        "lost_controllability": run.outcome.lost_controllability,
    }


def per_strain(rows: list[dict], name: str, peak: dict) -> float | None:
    """Mean of a count per 0.1 % of axial strain behind the peak."""
    if not rows:
        return None
    return sum(row[name] for row in rows) / (rows[-1]["axial_strain"] - peak["axial_strain"]) / 1e3


if __name__ == "__main__":
    script.run(main)
