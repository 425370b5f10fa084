"""A specimen compressed between smooth plates: walked along its load path, measured and told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from . import plotting, script
from .checkpoint import Saving
from .dem.packing import Packing
from .fem.problem import Problem
from .fem.stepping import LoadStepping, StepRecord
from .homogenised_law import HomogenisedLaw
from .load_path import Run, Scene, follow
from .plane_strain import PlaneStrain
from .reached import Reached

#: What a branch behind the peak must keep to be trusted: share of steps in balance, largest
#: FNORM/RNORM of any, share of the reactions' work that is lost.
BALANCED_STEPS, WORST_RESIDUAL, LOST_WORK = 0.95, 5e-2, 0.02

#: What is written for ParaView where nothing else is asked for.
FIELDS = ("stress", "deviatoric_strain", "void_ratio", "coordination_number", "fabric_anisotropy")

#: Of history.csv; a plane-strain run has the mean out-of-plane stress at the end of the row.
COLUMNS = (
    "step", "axial_strain", "stress_ratio", "axial_stress_Pa", "volumetric_strain", "void_ratio",
    "iterations", "evaluations", "residual", "converged", "cuts", "dem_steps", "unfinished_holds",
    "worst_unbalance", "largest_inertial_number", "largest_overlap", "failed_points", "moves",
    "work_J", "lost_work_J", "seconds",
)  # fmt: skip


@dataclass
class Specimen:
    """A specimen of grains under lateral pressure whose upper plate moves down.

    Attributes:
        problem: of its equilibrium.
        descent: prescribed displacement of the upper plate in a step, m.
        top: dofs along the axis at the upper plate.
        height: at the beginning, m.
        pressure: lateral, Pa, compression positive.
        law, points, mesh: of the problem.
        first_volume: m3; m3 per metre of thickness in 2D.
        first_void_ratio: mean of the specimen.
    """

    problem: Problem
    descent: fem.Constant
    top: np.ndarray
    height: float
    pressure: float
    first_volume: float = field(init=False)
    first_void_ratio: float = field(init=False)

    def __post_init__(self):
        self.law: HomogenisedLaw | PlaneStrain = self.problem.operator.law
        self.points = self.problem.operator.points
        self.mesh = self.points.mesh
        self.first_volume = self.volume()
        self.first_void_ratio = self.mean(self.law.void_ratio)

    def compress(self, start: float, end: float) -> None:
        """Let the plate go from one axial strain to another, both of the first height."""
        self.descent.value = -(end - start) * self.height

    def volume(self) -> float:
        """Of the specimen, m3; m3 per metre of thickness in 2D."""
        return self.mesh.comm.allreduce(float(self.points.volumes().sum()))

    def axial_stress(self, strain: float) -> float:
        """Force on the upper plate over the mean cross-section, Pa, compression positive."""
        mean_section = self.volume() / (self.height * (1 - strain))
        return -self.problem.reaction(self.top) / mean_section

    def mean(self, at_points: np.ndarray) -> float:
        """Volume average of a scalar (size,) over the specimen."""
        volumes = self.points.volumes()
        total = self.mesh.comm.allreduce(np.array([volumes @ at_points, volumes.sum()]))
        return float(total[0] / total[1])


def load(
    specimen: Specimen,
    strain: float,
    stepping: LoadStepping,
    path: Path,
    quiet: bool = False,
    saving: Saving | None = None,
    fields: Sequence[str] = FIELDS,
) -> Run:
    """Compress the specimen to an axial strain; steps are cut where they do not converge.

    Args:
        specimen: at its beginning.
        strain: of the first height, compression positive.
        stepping: sizes of steps.
        path: of the fields, without suffix; history.csv and run.log go beside them.
        quiet: show no progress.
        saving: checkpoints to write, and perhaps one to go on from.
        fields: names of the law's fields that are computed and written at every step.

    Raises what `load_path.follow` raises.
    """
    scene = Scene(
        specimen.problem,
        specimen.compress,
        columns_of(specimen.law),
        lambda record: row_of(specimen, record),
        lambda: fields_of(specimen.law, fields),
        lambda row: (
            f"strain {row['axial_strain']:.2%}  stress ratio {row['stress_ratio']:.3f}"
            f"  iterations {row['iterations']}"
        ),
    )
    return follow(scene, strain, stepping, path, quiet, saving)


def columns_of(law: HomogenisedLaw | PlaneStrain) -> tuple[str, ...]:
    """Names of the columns of history.csv."""
    return (*COLUMNS, "out_of_plane_stress_Pa") if isinstance(law, PlaneStrain) else COLUMNS


def fields_of(
    law: HomogenisedLaw | PlaneStrain, names: Sequence[str] = FIELDS
) -> dict[str, np.ndarray]:
    """What is written at every step, values at the points; stress is tension positive.

    With the stress goes that out of the plane, where there is one.
    """
    fields = {name: getattr(law, name) for name in names}
    if isinstance(law, PlaneStrain) and "stress" in names:
        fields["out_of_plane_stress"] = law.out_of_plane_stress
    return fields


def row_of(specimen: Specimen, record: StepRecord) -> dict[str, float]:
    """A row of history.csv; stresses are compression positive."""
    comm, law = specimen.mesh.comm, specimen.law
    axial = specimen.axial_stress(record.load)
    row = {
        "step": record.number,
        "axial_strain": record.load,
        "stress_ratio": axial / specimen.pressure,
        "axial_stress_Pa": axial,
        "volumetric_strain": specimen.volume() / specimen.first_volume - 1.0,
        "void_ratio": specimen.mean(law.void_ratio),
        "iterations": record.iterations,
        "evaluations": record.evaluations,
        "residual": record.residual,
        "converged": record.converged,
        "cuts": record.cuts,
        "dem_steps": comm.allreduce(law.tally.steps),
        "largest_inertial_number": comm.allreduce(law.tally.largest_inertial_number, MPI.MAX),
        "largest_overlap": comm.allreduce(law.tally.worst_overlap, MPI.MAX),
        "unfinished_holds": comm.allreduce(law.tally.unfinished),
        "worst_unbalance": comm.allreduce(law.tally.worst_unbalance, MPI.MAX),
        "failed_points": comm.allreduce(int(law.failed.sum())),
        "moves": record.moves,
        "work_J": record.work,
        "lost_work_J": record.lost_work,
        "seconds": record.seconds,
    }
    if isinstance(law, PlaneStrain):
        row["out_of_plane_stress_Pa"] = -specimen.mean(law.out_of_plane_stress)
    return row


def packing_at_extreme(specimen: Specimen, values: np.ndarray) -> Packing:
    """The packing of the point where `values` is largest in the whole specimen, on every rank."""
    comm = specimen.mesh.comm
    largest = float(values.max(initial=-np.inf))
    _, owner = max((value, -rank) for rank, value in enumerate(comm.allgather(largest)))
    packing = specimen.law.packing(int(values.argmax()) if comm.rank == -owner else None)
    return comm.bcast(packing, root=-owner)


def save_curves(path: Path, rows: list[dict[str, float]]) -> None:
    """Picture of stress ratio and volumetric strain against axial strain; on one rank."""
    names = ("axial_strain", "stress_ratio", "volumetric_strain")
    first = (0.0, 1.0, 0.0)
    curves = [
        np.array([start, *(row[name] for row in rows)])
        for name, start in zip(names, first, strict=True)
    ]
    plotting.save_history(path, *curves)


def tell(title: str, specimen: Specimen, run: Run, seconds: float, quiet: bool = False) -> int:
    """Print what came out of a run that took so many seconds; the exit code of the demo."""
    comm = specimen.mesh.comm
    if run.rows:
        script.print_table(comm, title, summary(specimen, run, seconds), quiet)
        warning = reached_by(specimen).warning
        if warning and comm.rank == 0:
            print(warning)
    if run.signal:
        if comm.rank == 0:
            print(f"{run.ending}; --resume goes on with it")
        return script.SIGNALLED + run.signal
    if run.outcome.lost_controllability:
        if comm.rank == 0:
            print(f"the load path ended early: {run.outcome.lost_controllability}")
        return script.LOST_CONTROLLABILITY
    return 0


def reached_by(specimen: Specimen) -> Reached:
    """What the packings of all ranks reached."""
    comm = specimen.mesh.comm
    return Reached.by(specimen.law, comm.allreduce, lambda x: comm.allreduce(x, MPI.MAX))


def trust(run: Run) -> str:
    """How far the branch behind the peak can be trusted, in a line."""
    ratios = [row["stress_ratio"] for row in run.rows]
    rows = run.rows[int(np.argmax(ratios)) + 1 :]
    if not rows:
        return "no step"
    balanced = sum(bool(row["converged"]) for row in rows) / len(rows)
    worst = max(row["residual"] for row in rows)
    lost = run.outcome.lost_work / max(run.outcome.work, 1e-300)
    good = balanced >= BALANCED_STEPS and worst <= WORST_RESIDUAL and lost <= LOST_WORK
    verdict = "to be trusted" if good else "NOT to be trusted"
    return f"{verdict}: {balanced:.0%} of {len(rows)} steps in balance, worst residual {worst:.1e}"


def summary(specimen: Specimen, run: Run, seconds: float) -> dict[str, str]:
    """The table at the end."""
    comm, tally = specimen.mesh.comm, specimen.law.tally
    outcome, rows = run.outcome, run.rows
    peak = max(rows, key=lambda row: row["stress_ratio"])
    angle = np.degrees(np.arcsin((peak["stress_ratio"] - 1) / (peak["stress_ratio"] + 1)))
    dem = comm.allreduce(tally.seconds + tally.tangent_seconds, MPI.MAX)
    crossings = f"{outcome.crossings} in {outcome.moves} moves"
    controlled = {"steps under indirect control": f"{outcome.controlled}"}
    return {
        "peak stress ratio": f"{peak['stress_ratio']:.3f}",
        "peak friction angle": f"{angle:.1f} degrees",
        "axial strain at peak": f"{peak['axial_strain']:.2%}",
        "axial strain at end": f"{outcome.load:.2%}",
        "void ratio, first and last": (
            f"{specimen.first_void_ratio:.4f}, {rows[-1]['void_ratio']:.4f}"
        ),
        "load steps": f"{outcome.steps}, {outcome.not_converged} of them not converged",
        "iterations": f"{outcome.iterations} ({outcome.evaluations} evaluations of the law)",
        "cut steps": f"{outcome.cuts}",
        **({"crossings to another equilibrium": crossings} if outcome.crossings else {}),
        **(controlled if outcome.controlled else {}),
        "work lost out of balance": f"{outcome.lost_work / max(outcome.work, 1e-300):.2%}",
        "behind the peak": trust(run),
        **reached_by(specimen).table,
        "failed points": f"{rows[-1]['failed_points']}",
        "seconds in DEM / FEM / the rest": (
            f"{dem:.1f} / {run.solving - dem:.1f} / {seconds - run.solving:.1f}"
        ),
    }
