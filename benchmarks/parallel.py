"""How well ranks and threads share the packings: measured here, replayed for many cores, and bytes.

Measured: a run of 512 points is brought behind its peak, and goes on from that checkpoint for some
load steps on 1 and 2 ranks, 1 and 2 threads. Work is counted in steps of the DEM, so that runs that
take other paths behind the peak can be compared. Replayed: the steps that each packing took in each
evaluation of a localised run (benchmarks/data), to load and to hold, are given to up to 5000
workers. Bytes: what a load step sends, beside what it would take to send the packings to a worker
and back at every evaluation.

Prints one JSON object as its last line.
"""

import argparse
import heapq
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "demos")]

from femxdem_fenicsx.dem.loading import HOLD_BLOCK  # noqa: E402
from femxdem_fenicsx.distribution import better_homes, place, price_of  # noqa: E402

SCENE = (
    "--mesh", "8", "16", "--element", "Q4", "--quiet",
    "--packing", str(ROOT / "tests" / "data" / "yade" / "packing.h5"),
)  # fmt: skip
COLUMNS, ROWS, POINTS = 8, 16, 4  # of SCENE: cells across and along, points of a cell
RECORDED = ROOT / "benchmarks" / "data" / "biaxial_8x16_costs.npz"
#: Of a point: stress, four scalars and a flag, when output asks.
FIELD_BYTES = 4 * 8 + 4 * 8 + 1
#: Strain from which on the recorded run is localised.
LOCALISED = 0.026
#: Strain behind the peak at which the measured runs begin.
BEHIND = 0.0265
#: (workers, threads of a rank): a rank has a machine, or a core, to itself.
REPLAYED = (
    (10, 1), (10, 10), (50, 1), (50, 10), (50, 25), (500, 1), (500, 25), (5000, 1), (5000, 25),
)  # fmt: skip
#: Desrues Table 3, by (grains, workers); Argilaga's note 9 has 0.86 for 512 elements on 50 cores.
PAPERS = {"400 grains": {10: 0.82, 50: 0.43}, "1600 grains": {50: 0.88}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer load steps behind the peak")
    parser.add_argument("--replay", action="store_true", help="nothing measured")
    parser.add_argument("--behind", type=Path, help="output of an earlier run behind the peak")
    parser.add_argument("--part", type=float, help=argparse.SUPPRESS)
    args, scene = parser.parse_known_args()
    if args.part is not None:
        measure(args.part, scene)
        return
    result = {"replayed": replay(), "papers": PAPERS}
    if not args.replay:
        with tempfile.TemporaryDirectory() as folder:
            behind = args.behind or Path(folder, "behind")
            if args.behind is None:
                run(1, os.cpu_count(), BEHIND, behind)
            steps = 4e-3 if args.quick else 1e-2
            result |= compare(behind, BEHIND + steps, Path(folder))
    print(json.dumps(result))


# ---- measured -----------------------------------------------------------------------------------


def compare(behind: Path, strain: float, folder: Path) -> dict:
    """The run on 1 and 2 ranks and threads from the same checkpoint on."""
    found = {}
    for ranks, threads in ((1, 1), (1, 2), (2, 1)):
        copy = folder / f"{ranks}x{threads}"
        copy.mkdir()
        subprocess.run(["cp", "-r", str(behind / "checkpoint"), str(copy)], check=True)
        found[ranks, threads] = run(ranks, threads, strain, copy, "--resume")
    alone = found[1, 1]
    measured = []
    for (ranks, threads), told in found.items():
        cores = ranks * threads
        row = {"ranks": ranks, "threads": threads}
        for what in ("law", "total"):
            speed, once = (t["dem_steps"] / t[f"{what}_s"] for t in (told, alone))
            row[f"{what}_efficiency"] = speed / once / cores
        measured.append(row | told)
    return {"measured": measured, "bytes_per_load_step": traffic(found[2, 1])}


def run(ranks: int, threads: int, strain: float, output: Path, *more: str) -> dict:
    """The scene to a strain; what `measure` has printed."""
    command = [sys.executable, __file__, "--part", str(strain), *SCENE]
    command += ["--threads", str(threads), "--output", str(output), *more]
    if ranks > 1:
        mpirun = ["mpirun", "--oversubscribe", "--bind-to", "none", "-n", str(ranks)]
        command = [*mpirun, *(["--allow-run-as-root"] if os.geteuid() == 0 else []), *command]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    told = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(told.stdout.splitlines()[-1])


class Timed:
    """The law, with the seconds that its evaluations and tangents take, exchange included."""

    def __init__(self, law):
        self.law, self.seconds, self.evaluations = law, 0.0, 0

    def __getattr__(self, name: str):
        return getattr(self.__dict__["law"], name)

    def evaluate(self, F):
        self.evaluations += 1
        return self._timed(self.law.evaluate, F)

    def tangent(self):
        return self._timed(self.law.tangent)

    def _timed(self, call, *arguments):
        started = perf_counter()
        result = call(*arguments)
        self.seconds += perf_counter() - started
        return result


def measure(strain: float, scene: list[str]) -> None:
    """Run the scene; print the seconds of the law and of all, and the steps of the DEM."""
    import biaxial
    from mpi4py import MPI

    from femxdem_fenicsx import script
    from femxdem_fenicsx.arguments import packing_for

    comm = MPI.COMM_WORLD
    args = biaxial.arguments().parse_args([*scene, "--strain", str(strain)])
    if comm.rank == 0:
        args.output.mkdir(parents=True, exist_ok=True)
    comm.barrier()
    specimen = biaxial.specimen_for(args, packing_for(args, comm, 2), comm)
    specimen.law.evaluate(np.tile(np.eye(2), (specimen.points.size, 1, 1)))  # compiles
    specimen.law.tangent()
    specimen.law.discard()
    law = Timed(specimen.law)
    specimen.law = specimen.problem.operator.law = law
    before = {}

    def note(*_):  # behind the loading of the checkpoint
        before.setdefault("steps", comm.allreduce(law.tally.steps))

    specimen.problem.solve = _before(specimen.problem.solve, note)
    done = biaxial.compress(specimen, args)
    told = {
        "law_s": comm.allreduce(law.seconds, MPI.MAX),
        "total_s": done.solving,
        "dem_steps": comm.allreduce(law.tally.steps) - before["steps"],
        "evaluations": law.evaluations,
        "load_steps": sum(row["axial_strain"] > BEHIND + 1e-9 for row in done.rows),
        "sent": {name: comm.allreduce(n) for name, n in getattr(law, "sent", {}).items()},
        "state_bytes": sum(array[:1].nbytes for array in law.state().values()),
    }
    if comm.rank == 0:
        print(json.dumps(told))
    script.sys.stdout.flush()


def _before(call, note):
    def noting(*arguments):
        note()
        return call(*arguments)

    return noting


def traffic(told: dict) -> dict:
    """Bytes of a load step: on 2 ranks; if no packing lived at the rank of its point; and if
    packings went out and back at each evaluation."""
    steps = max(told["load_steps"], 1)
    points, evaluations = COLUMNS * ROWS * POINTS, told["evaluations"] / steps
    ours = {name: sent / steps for name, sent in told["sent"].items()}
    return {
        "ours": sum(ours.values()),
        "by_purpose": ours,
        "ours_at_most": points * (evaluations * 2 * 4 * 8 + 16 * 8 + FIELD_BYTES),
        "moving_packings": points * evaluations * 2 * told["state_bytes"],
    }


# ---- replayed -----------------------------------------------------------------------------------


def replay() -> list[dict]:
    """Efficiency of workers behind the peak: mesh partition, our placement, the bound."""
    with np.load(RECORDED) as recorded:
        loading, hold = (recorded[name].astype(float) for name in ("loading", "hold"))
        load_step = recorded["load_step"].astype(int)
        first = int(np.searchsorted(recorded["axial_strain"], LOCALISED)) + 1
    steps = loading + hold
    guess = np.vstack([np.full_like(hold[:1], HOLD_BLOCK), hold[:-1]])
    found = []
    for workers, threads in REPLAYED:
        ranks = workers // threads
        partition = mesh_partition(ranks)
        counted = load_step >= first
        bound = efficiency(steps[counted], workers, longest(steps[counted], workers))
        row = {"workers": workers, "threads_per_rank": threads}
        for name, moves in (("static", False), ("balanced", True)):
            times, moved = schedule(steps, loading + guess, partition, ranks, threads, moves)
            row[name] = efficiency(steps[counted], workers, times[counted])
            row["moved_per_evaluation"] = moved
        row["ahead"] = ahead(steps[counted], partition, ranks, threads)
        found.append(row | {"bound": bound})
    return found


def efficiency(steps: np.ndarray, workers: int, times: np.ndarray) -> float:
    return float(steps.sum() / workers / times.sum())


def longest(steps: np.ndarray, workers: int) -> np.ndarray:
    """Least time of each evaluation: that of its longest packing, or of evenly shared work."""
    return np.maximum(steps.max(1), steps.sum(1) / workers)


def ahead(steps, home, ranks: int, threads: int) -> float:
    """Efficiency if all steps were known before, and moving packings took no time."""
    times = np.empty(len(steps))
    for e, cost in enumerate(steps):
        home = place(cost, home, ranks, threads)
        times[e] = evaluation(cost, cost, home, ranks, threads)
    return efficiency(steps, ranks * threads, times)


def schedule(steps, expected, home, ranks: int, threads: int, moves: bool):
    """Time of each evaluation, in steps, and packings moved per evaluation.

    As `DistributedLaw` and `Response` do it, by the expected steps: packings move where that pays,
    and within a rank the threads take the longest ones first.
    """
    times, moved = np.zeros(len(steps)), 0
    for e in range(len(steps)):
        new = better_homes(expected[e], home, ranks, threads) if moves else None
        if new is not None:
            moved += int((new != home).sum())
            times[e] = price_of(home, new, ranks)
            home = new
        times[e] += evaluation(steps[e], expected[e], home, ranks, threads)
    return times, moved / len(steps)


def evaluation(steps, expected, home, ranks: int, threads: int) -> float:
    """Steps until the last worker is ready: those of a rank take the longest packings first."""
    free = [[0.0] * threads for _ in range(ranks)]
    for packing in np.argsort(-expected, kind="stable"):
        workers = free[home[packing]]
        heapq.heapreplace(workers, workers[0] + steps[packing])
    return max(max(workers) for workers in free)


def mesh_partition(ranks: int) -> np.ndarray:
    """Rank of each point when DOLFINx' graph partitioner shares out the cells."""
    import dolfinx
    from mpi4py import MPI

    cells = np.arange(COLUMNS * ROWS)
    if ranks >= len(cells):
        return np.repeat(cells, POINTS)
    column, row = cells % COLUMNS, cells // COLUMNS
    near = abs(column[:, None] - column) + abs(row[:, None] - row) == 1
    first, second = np.nonzero(near)
    offsets = np.searchsorted(first, np.arange(len(cells) + 1)).astype(np.int32)
    graph = dolfinx.cpp.graph.AdjacencyList_int64(second.astype(np.int64), offsets)
    parts = dolfinx.cpp.graph.partitioner()(MPI.COMM_SELF, ranks, graph, False)
    return np.repeat(np.asarray(parts.array, np.int64), POINTS)


if __name__ == "__main__":
    main()
