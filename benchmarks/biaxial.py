"""The coupled biaxial test of `demos/biaxial.py`, beside the same run made with escript + YADE.

Prints one JSON object as its last line. Their run (`tests/data/yade/steps_2x4.csv`): about 75,000
core-microseconds per point and iteration on two cores of an AMD EPYC.
"""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np
from mpi4py import MPI

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "demos")]
import biaxial  # noqa: E402

from femxdem_fenicsx import script  # noqa: E402
from femxdem_fenicsx.arguments import DEFAULT_OPERATOR, packing_for  # noqa: E402

REFERENCE = ROOT / "tests" / "data" / "yade"


def main(comm: MPI.Comm) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--elements", type=int, nargs=2, default=(2, 4), metavar=("NX", "NY"))
    parser.add_argument("--strain", type=float, default=0.05)
    parser.add_argument("--accuracy", default="balanced")
    parser.add_argument("--operator", default=DEFAULT_OPERATOR)
    parser.add_argument("--formulation", default="small")
    parser.add_argument("--quick", action="store_true", help="stop at 1 % strain")
    args = script.parse(parser, comm)
    strain = min(args.strain, 0.01) if args.quick else args.strain
    with tempfile.TemporaryDirectory() as folder:
        options = {
            "--packing": REFERENCE / "packing.h5",
            "--formulation": args.formulation,
            "--strain": strain,
            "--accuracy": args.accuracy,
            "--operator": args.operator,
            "--element": "Q8",
            "--output": comm.bcast(folder),
        }
        words = [str(word) for option in options.items() for word in option]
        mesh = ["--mesh", *map(str, args.elements)]
        scene = biaxial.arguments().parse_args([*words, *mesh, "--quiet"])
        specimen = biaxial.specimen_for(scene, packing_for(scene, comm, scene.dim), comm)
        specimen.law.evaluate(np.tile(np.eye(2), (specimen.points.size, 1, 1)))  # compiles
        specimen.law.tangent()
        specimen.law.discard()
        specimen.law.tally.clear()
        started = perf_counter()
        run = biaxial.compress(specimen, scene)
        wall = perf_counter() - started
    result = figures(specimen, run, wall)
    result["against_escript_yade"] = comparison(run.rows, args.elements)
    if comm.rank == 0:
        print(json.dumps(result))
    return 0


def figures(specimen, run, wall) -> dict:
    outcome, rows = run.outcome, run.rows
    comm, tally = specimen.mesh.comm, specimen.law.tally
    points = comm.allreduce(specimen.points.size)
    dem = comm.allreduce(tally.seconds + tally.tangent_seconds, MPI.MAX)
    cores = specimen.law.response.threads * comm.size
    peak = max(rows, key=lambda row: row["axial_stress_Pa"])
    return {
        "wall_s": wall,
        "dem_s": dem,
        "fem_s": run.solving - dem,
        "load_steps": outcome.steps,
        "iterations": outcome.iterations,
        "evaluations": outcome.evaluations,
        "not_converged": outcome.not_converged,
        "cuts": outcome.cuts,
        "points": points,
        "core_us_per_point_iteration": 1e6 * wall * cores / points / outcome.evaluations,
        "dem_steps_per_evaluation": comm.allreduce(tally.steps) / points / outcome.evaluations,
        "strain_at_end": outcome.load,
        "peak_stress_kpa": peak["axial_stress_Pa"] / 1e3,
        "strain_at_peak": peak["axial_strain"],
        "stress_at_end_kpa": rows[-1]["axial_stress_Pa"] / 1e3,
        "lost_controllability": outcome.lost_controllability,
        "cpu_count": os.cpu_count(),
    }


def comparison(rows, elements) -> dict:
    """Largest difference of axial stress up to their peak, over theirs; iterations to 2.5 %."""
    path = REFERENCE / f"steps_{elements[0]}x{elements[1]}.csv"
    if not path.exists():
        return {}
    theirs = np.genfromtxt(path, delimiter=",", names=True)
    strain, stress = -theirs["axial_strain"], -theirs["sigma_yy_top_Pa"]
    ours = np.array(
        [[row["axial_strain"], row["axial_stress_Pa"], row["evaluations"]] for row in rows]
    )
    before = (
        (strain > 0) & (strain <= strain[stress.argmax()] + 1e-9) & (strain <= ours[-1, 0] + 1e-9)
    )
    difference = np.interp(strain[before], ours[:, 0], ours[:, 1]) / stress[before] - 1.0
    early, early_theirs = ours[:, 0] <= 0.025 + 1e-9, strain <= 0.025 + 1e-9
    return {
        "largest_difference_to_peak": float(np.abs(difference).max()),
        "difference_at_their_peak": float(difference[-1]),
        "evaluations_to_2.5_percent": int(ours[early, 2].sum()),
        "their_iterations_to_2.5_percent": int(theirs["newton_iterations"][early_theirs].sum()),
        "their_peak_kpa": float(stress.max() / 1e3),
    }


if __name__ == "__main__":
    script.run(main)
