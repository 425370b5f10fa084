"""Argilaga's study of the tangent operators (their sections 3-6), and our default scheme in it.

Drained biaxial compression to 2 % strain, 128 Q8 elements with 4 points each, 400 grains with
friction and cohesion, FNORM/RNORM <= 1e-2. Each operator drives a plain Newton iteration: no
first guess but the linear response, a new tangent in every iteration. "default" is what a user
gets. Steps are never cut; one that does not converge within 20 iterations is accepted below 5e-2
and counted.

Prints tables, and one JSON object as its last line. What is finished is kept in the output folder,
and a run that was stopped goes on from there. `--quick`: 8 elements; spectra of K^-1 J too, which
take two evaluations a degree of freedom.
"""

import argparse
import json
import os
import sys
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "demos")]
import biaxial  # noqa: E402

from femxdem_fenicsx import script  # noqa: E402
from femxdem_fenicsx.compression import Specimen, load  # noqa: E402
from femxdem_fenicsx.dem.contacts import LinearContact  # noqa: E402
from femxdem_fenicsx.dem.files import load_packing, save_packing  # noqa: E402
from femxdem_fenicsx.dem.packing import Packing  # noqa: E402
from femxdem_fenicsx.dem.preparation import random_packing  # noqa: E402
from femxdem_fenicsx.dem.tangents import OPERATORS, operator  # noqa: E402
from femxdem_fenicsx.fem.stepping import LoadStepping, walk  # noqa: E402

PRESSURE = 1e5
STRAIN, STEP, BEFORE, AFTER = 0.02, 5e-4, 0.005, 0.015
MOST_ITERATIONS = 20
LOOSER_LIMIT = 5e-2
#: Iterations of a convergence curve, which goes on below the tolerance.
CURVE = 15
#: Table 1: V_i, V_p. Fig. 7 is a picture; the text says: CTO/AEO = 100, PSTLO three times any
#: other, Kruyt's at least 10 % below 100, DEMQO 35 % below UKO.
PAPER = {
    "CTO": (0.20, None), "AEO": (0.20, 0.80), "DEMQO": (1.0, 1.0), "PSTLO": (1.0, 1.0),
    "UKO": (0.50, 0.67), "UCKO": (0.67, 1.0), "UCKO-2DOF": (0.86, 0.80), "KAO": (0.67, 0.67),
}  # fmt: skip


@dataclass
class Study:
    """What all runs share."""

    packing: Path
    mesh: tuple[int, int]
    spectra: bool
    folder: Path
    threads: int | None
    names: list[str]


def main(comm: MPI.Comm) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="2 x 4 elements")
    parser.add_argument("--output", type=Path, help="folder (results/operators or operators-quick)")
    parser.add_argument("--operators", nargs="+", help="whose runs to make (all and 'default')")
    parser.add_argument("--threads", type=int)
    args = script.parse(parser, comm)
    if comm.size > 1:
        raise ValueError("the study runs on one rank, with threads")
    quick = args.quick
    names = args.operators or [*OPERATORS, "default"]
    for name in set(names) - {"default"}:
        operator(name)
    folder = args.output or ROOT / "results" / ("operators-quick" if quick else "operators")
    folder.mkdir(parents=True, exist_ok=True)
    mesh = (2, 4) if quick else (8, 16)
    study = Study(prepared(folder), mesh, quick, folder, args.threads, names)
    runs = {
        name: kept(folder / f"{name}.json", lambda n=name: run(study, n)) for name in study.names
    }
    states = kept(folder / "states.json", lambda: at_two_states(study))
    result = summary(study, states, runs)
    print(table(result))
    print(json.dumps(result))
    return 0


def kept(path: Path, compute) -> dict:
    """What the file holds, or what is computed now and kept in it."""
    if not path.exists():
        print(f"{path.stem} ...", file=sys.stderr, flush=True)
        path.write_text(json.dumps(compute()))
    return json.loads(path.read_text())


def prepared(folder: Path) -> Path:
    """400 disks, k_n = k_t, k_n / (p t) = 1000, f_c = p <d> t, as dense as they get.

    k_n = k_t and the stiffness level are those that the papers' UKO and KAO matrices show (eq. 14,
    19); friction and cohesion are ours, for the paper does not give them.
    """
    path = folder / "packing.h5"
    if not path.exists():
        law = LinearContact(stiffness=1e7, stiffness_ratio=1.0, friction=0.5, cohesion=100.0)
        save_packing(path, random_packing(400, (3e-3, 7e-3), law, PRESSURE, 0.0, 1))
    return path


# The scene


def scene(study: Study, folder: str | Path, name: str | None = None) -> argparse.Namespace:
    words = {
        "--packing": study.packing, "--formulation": "finite", "--strain": STRAIN,
        "--step": STEP, "--element": "Q8", "--output": folder, "--pressure": PRESSURE,
        "--max-iterations": MOST_ITERATIONS, "--looser-tolerance": LOOSER_LIMIT,
    }  # fmt: skip
    if name is not None:
        words["--operator"] = name
    if study.threads is not None:
        words["--threads"] = study.threads
    flat = [str(word) for option in words.items() for word in option]
    return biaxial.arguments().parse_args([*flat, "--mesh", *map(str, study.mesh), "--quiet"])


@contextmanager
def plain_newton():
    """PETSc's Newton with a new tangent in every iteration."""
    options = PETSc.Options("femxdem_")
    options["snes_type"] = "newtonls"
    try:
        yield
    finally:
        options.delValue("snes_type")


def specimen_of(study: Study, args: argparse.Namespace, packing: Packing) -> Specimen:
    """The demo's, with compiled kernels."""
    specimen = biaxial.specimen_for(args, packing, MPI.COMM_WORLD)
    law = specimen.law
    law.evaluate(np.tile(np.eye(2), (specimen.points.size, 1, 1)))
    law.tangent()
    law.discard()
    law.tally.clear()
    return specimen


# A run with one operator


def run(study: Study, name: str) -> dict:
    """Iterations, evaluations (perturbed ones included) and seconds of every step to 2 %."""
    packing = load_packing(study.packing)
    with tempfile.TemporaryDirectory() as folder:
        if name == "default":
            args = scene(study, folder)
            specimen = specimen_of(study, args, packing)
        else:
            args = scene(study, folder, name)
            with plain_newton():
                specimen = specimen_of(study, args, packing)
            specimen.problem.first_guess = "tangent"
        probes = count_probes(specimen)
        counts: list[float] = []
        note_accepted(specimen, lambda: counts.append(probes()))
        stepping = LoadStepping(STEP, STEP, LOOSER_LIMIT)
        computed = process_time()
        done = load(specimen, STRAIN, stepping, Path(folder) / "run", quiet=True)
        computed = process_time() - computed
    if done.signal:  # half a run is not kept
        raise SystemExit(script.SIGNALLED + done.signal)
    perturbed = np.diff([0.0, *counts])
    return {
        "operator": args.operator,
        "strain": [row["axial_strain"] for row in done.rows],
        "stress_ratio": [row["stress_ratio"] for row in done.rows],
        "iterations": [row["iterations"] for row in done.rows],
        "evaluations": [
            row["evaluations"] + more for row, more in zip(done.rows, perturbed, strict=True)
        ],
        "converged": [bool(row["converged"]) for row in done.rows],
        "wall_s": done.solving,
        "cpu_s": computed,
        "tangent_s": specimen.law.tally.tangent_seconds,
        "dem_steps": specimen.law.tally.steps,
        "lost": done.outcome.lost_controllability,
    }


def count_probes(specimen: Specimen):
    """How many evaluations of all points the perturbed copies of tangents amount to so far."""
    response, count = specimen.law.response, [0]
    probe = response.probe

    def counted(F, *rest):
        count[0] += len(F)
        return probe(F, *rest)

    response.probe = counted
    return lambda: count[0] / specimen.points.size


def note_accepted(specimen: Specimen, note) -> None:
    """Call note() when a step has been solved and is about to be accepted."""
    accept = specimen.problem.accept

    def noted(step):
        note()
        accept(step)

    specimen.problem.accept = noted


# All operators at the same two states


def at_two_states(study: Study) -> dict:
    """Convergence curves, matrices and spectra at the first step and after the peak."""
    with tempfile.TemporaryDirectory() as folder:
        args = scene(study, folder)
        with plain_newton():
            specimen = specimen_of(study, args, load_packing(study.packing))
        operators = {name: operator(name) for name in OPERATORS}
        remembering = [each for each in operators.values() if hasattr(each, "memory")]

        def calibrate() -> None:
            if specimen.law.response.commits <= 5:
                for each in remembering:
                    each(specimen.law.response, specimen.law._F)

        note_accepted(specimen, calibrate)
        result = {}
        stepping = LoadStepping(STEP, STEP / 8, LOOSER_LIMIT)
        for state, start in (("start", 0.0), ("before", BEFORE), ("after", AFTER)):
            reached = result.get("reached", 0.0)
            if start > reached:
                walked = load_from(specimen, reached, start, stepping)
                result["reached"] = walked
            specimen.problem.forget()
            spectra = study.spectra and start > 0
            result[state] = study_state(study, specimen, operators, start, spectra)
        return result


def load_from(specimen: Specimen, start: float, end: float, stepping: LoadStepping) -> float:
    """Walk on with our own scheme; the strain that was reached."""
    return walk(specimen.problem, specimen.compress, end, stepping, start=start).load


def study_state(study, specimen, operators, strain, spectra: bool) -> dict:
    """Everything at the end of the step from `strain` on, whose solution is thrown away again."""
    problem, law = specimen.problem, specimen.law
    own, result = law._operator, {"strain": strain, "curves": {}, "matrices": {}, "spectra": {}}
    convergence = problem.convergence
    problem.first_guess = "tangent"
    problem.convergence = type(convergence)(1e-12, None, CURVE)
    problem.snes.setTolerances(max_it=CURVE)
    specimen.compress(strain, strain + STEP)
    best = None
    for name, each in operators.items():
        law._operator = each
        ratios: list[float] = []
        problem.snes.setMonitor(lambda *_, into=ratios: into.append(problem.residual))
        problem.solve(STEP)
        problem.snes.cancelMonitor()
        result["curves"][name] = ratios
        reached = min(ratios, default=np.inf)  # none where already the linear response goes astray
        if best is None or reached < best[0]:
            best = reached, problem.u.x.array.copy()
        law.discard()
    problem.u.x.array[:] = best[1]
    problem.balance.evaluate()
    A, B = 0, specimen.points.size // 2 + 1  # in two elements
    for name, each in operators.items():
        law._operator = each
        C = law.tangent()
        result["matrices"][name] = [(C[p].reshape(4, 4) / PRESSURE).tolist() for p in (A, B)]
    if spectra:
        result["spectra"] = spectra_of(study, specimen, operators)
    law._operator = own
    problem.reject()
    problem.first_guess = "increment"
    problem.convergence = convergence
    problem.snes.setTolerances(max_it=MOST_ITERATIONS)
    return result


def spectra_of(study, specimen, operators) -> dict:
    """Eigenvalues of K^-1 J; J by central differences of about the step's own strain."""
    problem = specimen.problem
    u = problem.u.x.array
    at, free = u.copy(), np.setdiff1d(np.arange(len(u)), problem.balance.constrained)
    size = STEP * specimen.height / study.mesh[1]
    J = np.zeros((len(free), len(free)))
    for column, dof in enumerate(free):
        forces = []
        for sign in (1.0, -1.0):
            u[:] = at
            u[dof] += sign * size
            problem.balance.evaluate()
            forces.append(problem.balance.forces.array_r[free].copy())
        J[:, column] = (forces[0] - forces[1]) / (2 * size)
    u[:] = at
    problem.balance.evaluate()
    spectra = {}
    for name, each in operators.items():
        specimen.law._operator = each
        problem._assemble_jacobian(problem.snes, problem._x, problem._matrix, problem._matrix)
        K = problem._matrix.getValues(free.astype(np.int32), free.astype(np.int32))
        values = np.linalg.eigvals(np.linalg.solve(K, J))
        spectra[name] = [values.real.tolist(), values.imag.tolist()]
    return spectra


# What comes out


def summary(study: Study, states: dict, runs: dict) -> dict:
    """The result, with the keys that are compared from release to release."""
    judge = runs["default" if "default" in runs else next(iter(runs))]
    in_balance = np.where(judge["converged"], judge["stress_ratio"], 0.0)
    peak = int(in_balance.argmax())
    rows = {}
    for name, one in runs.items():
        iterations, evaluations = np.array(one["iterations"]), np.array(one["evaluations"])
        rows[name] = {
            "iterations_pre": mean(iterations[: peak + 1]),
            "iterations_post": mean(iterations[peak + 1 :]),
            "evaluations_pre": mean(evaluations[: peak + 1]),
            "evaluations_post": mean(evaluations[peak + 1 :]),
            "wall_s": one["wall_s"],
            "cpu_s": one.get("cpu_s"),
            "tangent_s": one["tangent_s"],
            "failed_steps": int(np.sum(~np.array(one["converged"]))),
            "strain_at_end": one["strain"][-1],
        }
    unit = rows.get("PSTLO", rows[study.names[0]])
    for row in rows.values():
        for name, when in (("V_i", "pre"), ("V_p", "post")):
            ours, least = row[f"evaluations_{when}"], unit[f"evaluations_{when}"]
            row[name] = None if ours is None or least is None else least / ours
    return {
        "operators": rows,
        "mesh": study.mesh,
        "step": STEP,
        "strain_at_peak": judge["strain"][peak],
        "default_operator": runs["default"]["operator"] if "default" in runs else None,
        "states": states,
        "cpu_count": os.cpu_count(),
    }


def mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if len(values) else None


def table(result: dict) -> str:
    """Markdown: ours beside the paper's."""
    rows = result["operators"]

    lines = [
        "| operator | iterations per step, before / after the peak | evaluations per step"
        " | wall-clock, AEO = 100 | tangents, s of s | not converged | V_i (paper) | V_p (paper) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    whole = rows["AEO"]["wall_s"] if "AEO" in rows else next(iter(rows.values()))["wall_s"]
    for name, row in rows.items():
        initial, post = PAPER.get(name, (None, None))
        lines.append(
            f"| {name} | {number(row['iterations_pre'])} / {number(row['iterations_post'])}"
            f" | {number(row['evaluations_pre'])} / {number(row['evaluations_post'])}"
            f" | {100 * row['wall_s'] / whole:.0f}"
            f" | {row['tangent_s']:.1f} of {row['wall_s']:.1f} | {row['failed_steps']}"
            f" | {number(row['V_i'], 2)} ({number(initial, 2)})"
            f" | {number(row['V_p'], 2)} ({number(post, 2)}) |"
        )
    return "\n".join(lines)


def number(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


if __name__ == "__main__":
    script.run(main)
