"""Past the peak: biaxial compression to 10 % strain, as in Guo and Zhao (2014) section 4.

Prints one JSON object as its last line. `--quick`: 2 x 4 Q8 to 4.6 %, where the run of escript +
YADE ends (`tests/data/yade/steps_2x4.csv`), and 6 x 10 Q4 to 10 %. Otherwise Guo and Zhao's meshes
too, Q8 with their 3 x 3 points; 12 x 20 Q4 and 6 x 10 Q8 with friction varied a little, as nothing
prefers a band where all is even (docs/localisation.md). `--runs` chooses some by their names. Each
run keeps its checkpoints and its result in a folder below `--output`: started again, the benchmark
goes on where it was stopped.
"""

import argparse
import json
import os
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "demos")]
import biaxial  # noqa: E402

from femxdem_fenicsx import script  # noqa: E402
from femxdem_fenicsx.arguments import packing_for  # noqa: E402
from femxdem_fenicsx.compression import BALANCED_STEPS, LOST_WORK, WORST_RESIDUAL  # noqa: E402
from femxdem_fenicsx.fem.output import on_first_rank, writable_folder  # noqa: E402
from femxdem_fenicsx.shear_band import measure  # noqa: E402

PACKING = ROOT / "tests" / "data" / "yade" / "packing.h5"
VOLUME = "volumetric_strain"


@dataclass(frozen=True)
class Case:
    mesh: tuple[int, int]
    element: str
    points: str
    strain: float
    friction_variability: float = 0.0

    @property
    def name(self) -> str:
        varied = f"_varied_{self.friction_variability:g}" if self.friction_variability else ""
        return f"{self.mesh[0]}x{self.mesh[1]}_{self.element}_{self.points}{varied}"


QUICK = (Case((2, 4), "Q8", "2x2", 0.046), Case((6, 10), "Q4", "2x2", 0.1))
FULL = (
    *QUICK,
    Case((10, 15), "Q4", "2x2", 0.1),
    Case((12, 20), "Q4", "2x2", 0.1, 0.05),
    Case((6, 10), "Q8", "3x3", 0.1, 0.05),
)


def main(comm: MPI.Comm) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--output", type=Path, default=ROOT / "results" / "localisation")
    parser.add_argument("--formulation", default="small", help="Guo and Zhao's is small")
    parser.add_argument("--path-following", default="indirect", help="where a path is lost")
    parser.add_argument("--friction-variability", type=float, help="in place of each run's own")
    parser.add_argument("--runs", nargs="+", help="their names, as 6x10_Q4_2x2")
    args = script.parse(parser, comm)
    runs = [run(comm, args, case) for case in chosen(args)]
    good = all(
        one["nonconverged_steps"] <= (1 - BALANCED_STEPS) * one["steps"]
        and one["worst_residual"] <= WORST_RESIDUAL
        and one["lost_work_share"] <= LOST_WORK
        and one["strain_reached"] >= one["strain_asked"] - 1e-9
        for one in runs
    )
    if comm.rank == 0:
        print(json.dumps({"runs": runs, "in_balance": good, "cpu_count": os.cpu_count()}))
    return 0


def chosen(args) -> list[Case]:
    """The runs that are asked for. ValueError: none has that name."""
    cases = QUICK if args.quick else FULL
    if args.friction_variability is not None:
        cases = [replace(case, friction_variability=args.friction_variability) for case in cases]
    names = [case.name for case in cases]
    if unknown := set(args.runs or ()) - set(names):
        raise ValueError(f"--runs {' '.join(sorted(unknown))}: choose from {', '.join(names)}")
    return [case for case in cases if args.runs is None or case.name in args.runs]


def run(comm: MPI.Comm, args, case: Case) -> dict:
    """One mesh: its result, from its folder where it was computed before."""
    folder = writable_folder(comm, args.output / case.name)
    if comm.bcast((folder / "result.json").exists()):
        return json.loads((folder / "result.json").read_text())
    options = {
        "--packing": PACKING,
        "--element": case.element,
        "--points": case.points,
        "--strain": case.strain,
        "--formulation": args.formulation,
        "--path-following": args.path_following,
        "--output": folder,
    }
    if case.friction_variability:
        options["--friction-variability"] = case.friction_variability
    words = [str(word) for option in options.items() for word in option]
    if comm.bcast(any((folder / "checkpoint").glob("step_*"))):
        words.append("--resume")
    parser = biaxial.arguments()
    scene = parser.parse_args([*words, "--mesh", *map(str, case.mesh), "--quiet"])
    scene.defaults = {action.dest: action.default for action in parser._actions}
    specimen = biaxial.specimen_for(scene, packing_for(scene, comm, scene.dim), comm)
    walked = biaxial.compress(specimen, scene)
    if walked.signal:
        raise SystemExit(script.SIGNALLED + walked.signal)
    result = asdict(case) | {"gradient": "first", "strain_asked": case.strain}
    result |= figures(specimen, walked)
    on_first_rank(comm, (folder / "result.json").write_text, json.dumps(result))
    return result


def figures(specimen, run) -> dict:
    """What the run is measured by."""
    rows, outcome = run.rows, run.outcome
    peak = max(rows, key=lambda row: row["axial_stress_Pa"])
    angle = np.degrees(np.arcsin((peak["stress_ratio"] - 1) / (peak["stress_ratio"] + 1)))
    return {
        "strain_reached": outcome.load,
        "steps": outcome.steps,
        "evaluations": outcome.evaluations,
        "nonconverged_steps": outcome.not_converged,
        "worst_residual": max(row["residual"] for row in rows),
        "cuts": outcome.cuts,
        "crossings": outcome.crossings,
        "lost_work_share": outcome.lost_work / outcome.work,
        "wall_s": sum(row["seconds"] for row in rows),
        "peak_kpa": peak["axial_stress_Pa"] / 1e3,
        "strain_at_peak": peak["axial_strain"],
        "residual_kpa": rows[-1]["axial_stress_Pa"] / 1e3,
        "failed_points": rows[-1]["failed_points"],
        "mohr_coulomb_angle_deg": 45 + angle / 2,
        "roscoe_angle_deg": 45 + dilation_angle(rows, peak["axial_strain"]) / 2,
        "points": specimen.mesh.comm.allreduce(specimen.points.size),
        **band(specimen),
        "lost_controllability": outcome.lost_controllability,
    }


def dilation_angle(rows: list[dict], peak: float) -> float:
    """At the peak, degrees: sin psi = -(d e1 + d e3)/(d e1 - d e3), from half a percent around."""
    near = [row for row in rows if abs(row["axial_strain"] - peak) < 5.1e-3]
    axial, volumetric = ([row[name] for row in near] for name in ("axial_strain", VOLUME))
    slope = np.polyfit(axial, volumetric, 1)[0]
    return float(np.degrees(np.arcsin(slope / (2 + slope))))


def band(specimen) -> dict:
    """Inclination of the band to the horizontal, its width, the strain in it over that outside."""
    comm = specimen.mesh.comm
    parts = comm.allgather((specimen.points.coordinates()[:, :2], specimen.law.deviatoric_strain))
    x, strain = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    try:
        found = measure(x, strain)
    except ValueError:
        return {"band_angle_deg": None}
    return {
        "band_angle_deg": abs(found.angle),
        "band_width_mm": 1e3 * found.width,
        "band_contrast": found.contrast,
    }


if __name__ == "__main__":
    script.run(main)
