"""A run for test_parallel.py: ``python -m tests.fem.parallel_run numbers|raise FOLDER|astray``."""

import json
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.path_following import Crossing
from femxdem_fenicsx.fem.stepping import LoadStepping, walk
from femxdem_fenicsx.law import Softening
from tests.fem.laws import Failing, Fragile
from tests.fem.snap_back import K0, PEAK, bar
from tests.fem.specimen import Specimen

COMM = MPI.COMM_WORLD


def by_number(points) -> np.ndarray:
    return 0.02 * (1 + 0.3 * np.sin(1.7 * points.index))


#: Element, modulus of the second gradient, formulation, cells, micro-strain. Of one cell, a rank
#: has none.
CASES = [
    *((name, None, formulation, None, "linear") for name in ("Q4", "Q8", "T6", "H8", "T10")
      for formulation in ("small", "finite")),
    ("Q8", 0.5, "finite", None, "linear"), ("T6", 0.5, "small", None, "linear"),
    ("Q8", 0.5, "small", None, "quadratic"),
    ("Q4", None, "small", (1, 1), "linear"), ("Q8", 0.5, "finite", (1, 1), "linear"),
]  # fmt: skip


def numbers() -> dict:
    found = {}
    for name, modulus, formulation, cells, micro_strain in CASES:
        dim = element(name).dim
        specimen = Specimen(
            lambda points, dim=dim: Softening(points.size, 100.0, 0.3, by_number(points), dim),
            name=name,
            formulation=formulation,
            modulus=modulus,
            micro_strain=micro_strain,
            cells=cells,
            rough=True,
            tolerance=1e-13,
        )
        specimen.pressure.value = 0.2
        forces = []
        outcome = walk(
            specimen.problem,
            specimen.compress,
            0.012,
            LoadStepping(0.004),
            lambda record, s=specimen, f=forces: f.append([s.top_force(), s.volume()]),
        )
        x = specimen.points.coordinates()
        total = COMM.allreduce((specimen.points.index[:, None] * x).sum(axis=0))
        case = f"{name} {formulation} {modulus} {cells} {micro_strain}"
        found[case] = [*np.ravel(forces), *total, outcome.evaluations]
        if modulus is not None:
            squares = sum((state.values**2).sum() for state in specimen.operator.states)
            found[case].append(COMM.allreduce(float(squares)))
    found["crossing"] = crossing()
    found["indirect"] = indirect()
    return found


def crossing() -> list[float]:
    """A bar that snaps to another equilibrium."""
    specimen = bar(cells=(2, 3))
    stepping = LoadStepping(0.13 * K0, 0.13 * K0, looser_limit=0.0, crossing=Crossing())
    outcome = walk(specimen.problem, specimen.compress, 1.2 * PEAK, stepping)
    works = outcome.work, outcome.lost_work
    return [specimen.top_force(), *works, outcome.crossings, outcome.moves, outcome.evaluations]


def indirect() -> list[float]:
    """The same bar, its snap-back followed in equilibrium."""
    specimen = bar(cells=(2, 3))
    stepping = LoadStepping(0.13 * K0, looser_limit=0.0, indirect=True)
    outcome = walk(specimen.problem, specimen.compress, 1.2 * PEAK, stepping)
    return [
        specimen.top_force(),
        outcome.work,
        outcome.controlled,
        outcome.steps,
        outcome.evaluations,
    ]


def fail(error: Exception) -> None:
    law = lambda points: Failing(points.size, error, fails=COMM.rank == COMM.size - 1)  # noqa: E731
    specimen = Specimen(law, formulation="small", rough=True)
    walk(specimen.problem, specimen.compress, 0.01, LoadStepping(0.001))


def astray() -> dict:
    """A law that gives up on one rank only: all cut the step and arrive."""

    def law(points):
        limit = 0.006 if COMM.rank == 0 else 1.0
        return Fragile(points.size, limit)

    specimen = Specimen(law, distortion=0.0)
    outcome = walk(specimen.problem, specimen.compress, 0.02, LoadStepping(0.01))
    return {"load": outcome.load, "cuts": outcome.cuts}


if __name__ == "__main__":
    task = sys.argv[1]
    if task == "raise":
        try:
            fail(RuntimeError("the packing exploded"))
        except RuntimeError as error:
            # into a file: mpirun ends all ranks, and drops their last words, when the first exits
            Path(sys.argv[2], f"rank{COMM.rank}").write_text(str(error))
            COMM.barrier()
            sys.exit(1)
    result = numbers() if task == "numbers" else astray()
    if COMM.rank == 0:
        print(json.dumps(result))
