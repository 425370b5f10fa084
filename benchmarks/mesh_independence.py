"""Shear bands of `demos/biaxial.py` on finer and finer meshes, first and second gradient.

Desrues section 4.5 and eq. 46: with the second gradient the width of a band does not depend on
the mesh, and goes with the square root of D. A dent in one side gives the band its place. The
width is measured at the same strain in all runs (`femxdem_fenicsx.shear_band`). Prints one JSON
object as its last line; each finished run is kept in the output folder and not run again.
"""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from time import perf_counter

import numpy as np
from mpi4py import MPI

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "demos")]
import biaxial  # noqa: E402

from femxdem_fenicsx import script, shear_band  # noqa: E402
from femxdem_fenicsx.arguments import packing_for  # noqa: E402
from femxdem_fenicsx.collective import together  # noqa: E402
from femxdem_fenicsx.compression import load  # noqa: E402
from femxdem_fenicsx.fem.stepping import LoadStepping  # noqa: E402

#: Columns of elements, and D in N (None: first gradient).
FULL = [(8, 10.0), (16, 10.0), (32, 10.0), (16, 3.2), (16, 1.0), (32, 1.0),
        (8, None), (16, None), (32, None)]  # fmt: skip
QUICK = [(8, 10.0), (16, 10.0), (8, None), (16, 1.0), (16, 3.2), (16, None)]
SCENE = {"--element": "Q8", "--imperfection": 0.02, "--step": 5e-4, "--tolerance": 2e-2,
         "--looser-tolerance": 0.1, "--max-iterations": 12}  # fmt: skip


def main(comm: MPI.Comm) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--grains", type=int, help="per point  (default: 400, quick 100)")
    parser.add_argument("--strain", type=float, default=0.03, help="axial strain of the measure")
    parser.add_argument("--quick", action="store_true", help="few grains, two meshes")
    parser.add_argument("--output", type=Path, help="folder of runs  (default: results/...)")
    args = script.parse(parser, comm)
    grains = args.grains or (100 if args.quick else 400)
    mode = "quick" if args.quick else "full"
    folder = args.output or ROOT / "results" / f"mesh_independence_{mode}"
    runs = []
    for columns, modulus in QUICK if args.quick else FULL:
        name = f"{2 * columns**2}_{'first' if modulus is None else modulus}"
        path = folder / name / "run.json"
        if comm.bcast(path.exists()):
            runs.append(json.loads(path.read_text()))
            continue
        options = {
            **SCENE,
            "--grains": grains,
            "--strain": args.strain,
            "--accuracy": "fast" if args.quick else "balanced",
            "--output": path.parent,
        }
        if modulus is not None:
            options |= {"--gradient": "second", "--second-gradient-modulus": modulus}
        words = [str(word) for option in options.items() for word in option]
        runs.append(compress(comm, [*words, "--mesh", str(columns), str(2 * columns)], modulus))
        together(comm, save, comm, path, runs[-1])
    if comm.rank == 0:
        print(json.dumps({"grains": grains, "strain": args.strain, "runs": runs}))
    return 0


def save(comm: MPI.Comm, path: Path, run: dict) -> None:
    if comm.rank == 0:
        path.write_text(json.dumps(run))
        print(json.dumps(run), flush=True)


def compress(comm: MPI.Comm, words: list[str], modulus: float | None) -> dict:
    """One run, measured."""
    args = biaxial.arguments().parse_args([*words, "--quiet"])
    together(comm, lambda: args.output.mkdir(parents=True, exist_ok=True))
    specimen = biaxial.specimen_for(args, packing_for(args, comm, 2), comm)
    points = specimen.points
    x = points.coordinates()
    started = perf_counter()
    stepping = LoadStepping(args.step, args.step / 2, args.looser_tolerance)
    run = load(specimen, args.strain, stepping, args.output / "biaxial", quiet=True)
    cells = len(points.cells)
    strain = specimen.law.deviatoric_strain
    found = points.gather(x.reshape(cells, -1, 2), strain.reshape(cells, -1))
    band = comm.bcast(together(comm, measure, found))
    rows, tally = run.rows, specimen.law.tally
    peak = max(range(len(rows)), key=lambda k: rows[k]["stress_ratio"])
    after = rows[peak + 1 :]
    dem = comm.allreduce(tally.seconds + tally.tangent_seconds, MPI.MAX)
    return {
        "elements": args.mesh[0] * args.mesh[1],
        "gradient": args.gradient,
        "D": modulus,
        "band_width": band["width"],
        "band": band,
        "iterations": run.outcome.iterations,
        "evaluations": run.outcome.evaluations,
        "residual_stress_kpa": rows[-1]["axial_stress_Pa"] / 1e3,
        "peak_stress_kpa": rows[peak]["axial_stress_Pa"] / 1e3,
        "strain_at_peak": rows[peak]["axial_strain"],
        "strain_at_end": run.outcome.load,
        "steps_after_peak": len(after),
        "iterations_per_0.1_percent_after_peak": per_strain(after, "iterations", rows[peak]),
        "evaluations_per_0.1_percent_after_peak": per_strain(after, "evaluations", rows[peak]),
        "not_converged_after_peak": sum(not row["converged"] for row in after),
        "fem_seconds": run.solving - dem,
        "fem_share": (run.solving - dem) / run.solving,
        "wall_seconds": perf_counter() - started,
        "lost_controllability": run.outcome.lost_controllability,
    }


def measure(found) -> dict | None:
    """On rank 0; a field without a band has width None."""
    if found is None:
        return None
    x, strain = (np.concatenate(list(array)) for array in found)
    try:
        return asdict(shear_band.measure(x, strain))
    except ValueError as error:
        return {"width": None, "why": str(error)}


def per_strain(rows: list[dict], name: str, peak: dict) -> float | None:
    """Mean of a count per 0.1 % of axial strain behind the peak."""
    if not rows:
        return None
    return sum(row[name] for row in rows) / (rows[-1]["axial_strain"] - peak["axial_strain"]) / 1e3


if __name__ == "__main__":
    script.run(main)
