"""What docs/localisation.md shows: the law's roughness, the spectrum along the way, the runs.

The runs are those of `benchmarks/localisation.py`, which keeps them in results/localisation; those
that are there are taken over.
"""

import json
from pathlib import Path

import numpy as np
from figures_common import FIGURES, PACKING, RESULTS, YADE, keep, python, table
from matplotlib.figure import Figure
from mpi4py import MPI

# figures_common tells where demos are
# isort: split
import biaxial

from femxdem_fenicsx import plotting
from femxdem_fenicsx.arguments import packing_for, stepping_of
from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.element_tests import drained_biaxial
from femxdem_fenicsx.dem.files import load_packing, save_packing
from femxdem_fenicsx.dem.lattices import hexagonal_packing
from femxdem_fenicsx.fem.stepping import walk
from femxdem_fenicsx.homogenised_law import HomogenisedLaw

#: Axial strains of the packings whose stress is followed along a line.
STATES = (0.01, 0.03, 0.06)
#: Axial strains of the increments along a line.
LINE = np.linspace(0.9e-3, 1.1e-3, 81)
BALANCED = PRESETS["balanced"]
SLOWEST = BALANCED.but(inertial_number=3e-6, tolerance=1e-4, hold_limit=20000)
SETTINGS = {
    "I = 1e-2": BALANCED.but(inertial_number=1e-2),
    "balanced": BALANCED,
    "I = 3e-4": BALANCED.but(inertial_number=3e-4),
    "tolerance 3e-3": BALANCED.but(tolerance=3e-3),
    "tolerance 1e-3": BALANCED.but(tolerance=1e-3),
    "hold of 100 steps": BALANCED.but(tolerance=1e-9, hold_limit=100),
    "reference": PRESETS["reference"],
}


def deviatoric(stress: np.ndarray) -> np.ndarray:
    """Half the difference of the principal stresses of (..., 2, 2)."""
    return np.hypot(0.5 * (stress[..., 0, 0] - stress[..., 1, 1]), stress[..., 0, 1])


# The law's roughness: the stress along a line of increments, which differ by 0.25 % from one to
# the next. Half the second difference is what a smooth curve leaves nothing of.


def run_roughness() -> None:
    packings, result = sheared(load_packing(YADE / "packing.h5", 2)), {}
    for name, accuracy in {"slow": SLOWEST, **SETTINGS}.items():
        laws = [HomogenisedLaw(packing, len(LINE), accuracy, threads=2) for packing in packings]
        stresses = np.array([law.evaluate(line()) for law in laws])
        steps = sum(law.tally.steps for law in laws) / stresses[..., 0, 0].size
        if name == "slow":
            slow = stresses
        result[name] = roughness(stresses, slow) | {"steps": steps}
        print(name, result[name], flush=True)
        result[name]["line"] = deviatoric(stresses[1]).tolist()
    (FIGURES / "localisation_roughness.json").write_text(json.dumps(result))


def sheared(packing) -> list:
    """The packing at the strains `STATES` of a drained biaxial test."""
    law, found = HomogenisedLaw(packing, 1, BALANCED), []
    for state in drained_biaxial(law, 1e5, max(STATES), 1e-3, tolerance=3e-3):
        if len(found) < len(STATES) and state.axial_strain > STATES[len(found)] - 1e-6:
            found.append(law.packing(0))
    return found


def line() -> np.ndarray:
    """F (n, 2, 2): compression with the dilation of a dense packing past its peak."""
    return np.eye(2) + LINE[:, None, None] * np.diag([1.2, -1.0])


def roughness(stresses: np.ndarray, slow: np.ndarray) -> dict:
    """Of stresses (states, n, 2, 2), over the pressure: rms roughness, largest jump, error."""
    pressure = np.trace(stresses, axis1=-2, axis2=-1).mean(1)[:, None, None, None] / -2.0
    scaled = stresses / pressure
    second = np.diff(scaled, 2, axis=1)
    return {
        "roughness": [float(v) for v in np.sqrt((second**2).mean((1, 2, 3)) / 6)],
        "jump": [float(v) for v in np.abs(np.diff(scaled, axis=1)).max((1, 2, 3))],
        "error": float(np.sqrt(((scaled - slow / pressure) ** 2).mean())),
    }


def draw_roughness() -> None:
    result = json.loads((FIGURES / "localisation_roughness.json").read_text())
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, one in result.items():
        place = one["steps"], 100 * np.sqrt(np.mean(np.square(one["roughness"])))
        left.loglog(*place, "o", color=plotting.COLOURS[0])
        left.annotate(
            name,
            place,
            xytext=(4, 4 if name not in ("I = 1e-2", "I = 3e-4") else -12),
            textcoords="offset points",
            fontsize=8,
        )
    left.set(xlabel="DEM steps per evaluation", ylabel="roughness (% of the pressure)")
    left.set(xlim=(60, 3e5), ylim=(1e-3, 0.1))
    for name in ("I = 1e-2", "balanced", "reference", "slow"):
        curve = np.array(result[name]["line"])
        right.plot(1e3 * LINE, curve / 1e3, ".-", ms=3, label=name)
    right.set(xlabel="strain of the increment (1e-3)", ylabel="deviatoric stress (kPa)")
    right.legend(fontsize=7)
    figure.savefig(FIGURES / "localisation_roughness.png", dpi=110)


# The spectrum of K^-1 J along the way, 2 x 4 Q8: J by differences of the step's own strain, K the
# law's operator (PSTLO). A negative eigenvalue is a limit point passed.


def run_spectrum() -> None:
    words = "--mesh 2 4 --element Q8 --formulation small --strain 0.05 --quiet --packing"
    scene = biaxial.arguments().parse_args([*words.split(), str(PACKING)])
    comm = MPI.COMM_SELF
    specimen = biaxial.specimen_for(scene, packing_for(scene, comm, 2), comm)
    rows, end = [], 0.0
    while end < 0.0449:
        walk(specimen.problem, specimen.compress, end + 5e-3, stepping_of(scene), start=end)
        end += 5e-3
        values = np.sort(spectrum(specimen, scene.step).real)
        rows.append([end, *values[:6], np.median(values), values[-1], (values < 0).sum()])
        print(*rows[-1], flush=True)
    header = "strain,e1,e2,e3,e4,e5,e6,median,largest,negative"
    path = FIGURES / "localisation_spectrum.csv"
    np.savetxt(path, rows, fmt="%.6g", delimiter=",", header=header, comments="")


def spectrum(specimen, step: float) -> np.ndarray:
    """Eigenvalues of K^-1 J at the committed state, for increments of the step's strain."""
    problem = specimen.problem
    u = problem.u.x.array
    free = np.setdiff1d(np.arange(len(u)), problem._constrained)
    size = step * specimen.height / 4
    rows = free.astype(np.int32)
    K = problem.stiffness().getValues(rows, rows)
    J = np.zeros_like(K)
    for column, dof in enumerate(free):
        forces = []
        for sign in (1.0, -1.0):
            u[:] = 0.0
            u[dof] = sign * size
            problem._evaluate_at_u()
            forces.append(problem._forces.array_r[free].copy())
        J[:, column] = (forces[0] - forces[1]) / (2 * size)
    problem.reject()
    return np.linalg.eigvals(np.linalg.solve(K, J))


def draw_spectrum() -> None:
    data = np.genfromtxt(FIGURES / "localisation_spectrum.csv", delimiter=",", names=True)
    figure = Figure(figsize=(5.5, 4), layout="constrained")
    axes = figure.subplots()
    for k in range(1, 7):
        axes.plot(100 * data["strain"], data[f"e{k}"], "o-", ms=3, color=plotting.COLOURS[0])
    axes.plot(100 * data["strain"], data["median"], "s-", ms=3, color=plotting.COLOURS[1])
    axes.axhline(0.0, color="black", lw=0.6)
    axes.set(xlabel="axial strain (%)", ylabel="eigenvalues of $K^{-1}J$: six lowest, median")
    figure.savefig(FIGURES / "localisation_spectrum.png", dpi=110)


# The runs: stress, balance, volume; and the hexagonal packing, which breaks.


def draw_runs() -> None:
    names = {
        "2x4_q8": "2 x 4 Q8",
        "6x10_q4": "6 x 10 Q4",
        "10x15_q4": "10 x 15 Q4",
        "12x20_q4_varied": "12 x 20 Q4, friction varies by 0.05",
        "6x10_q8_3x3_varied": "6 x 10 Q8, 3 x 3 points, the same",
    }
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, label in names.items():
        data = table(f"localisation_{name}")
        left.plot(100 * data["axial_strain"], data["stress_ratio"], label=label)
        right.semilogy(100 * data["axial_strain"], data["residual"], ".", ms=4, label=label)
    theirs = np.genfromtxt(YADE / "steps_2x4.csv", delimiter=",", names=True)
    style = {"color": "black", "lw": 0.8, "ls": "--", "label": "escript + YADE, 2 x 4 Q8"}
    left.plot(-100 * theirs["axial_strain"], -theirs["sigma_yy_top_Pa"] / 1e5, **style)
    left.set(xlabel="axial strain (%)", ylabel="stress ratio", ylim=(0.9, 3.0))
    left.legend(fontsize=8)
    right.set(xlabel="axial strain (%)", ylabel="FNORM/RNORM of the step")
    figure.savefig(FIGURES / "localisation_runs.png", dpi=110)


def draw_hexagonal() -> None:
    figure = Figure(figsize=(5.5, 4), layout="constrained")
    axes = figure.subplots()
    for name, style in (("crossing", "o-"), ("none", "x-")):
        data = table(f"localisation_hexagonal_{name}")
        axes.plot(100 * data["axial_strain"], data["stress_ratio"], style, ms=3, label=name)
    axes.set(xlabel="axial strain (%)", ylabel="stress ratio")
    axes.legend(title="--path-following")
    figure.savefig(FIGURES / "localisation_hexagonal.png", dpi=110)


def keep_history(history: Path, name: str) -> None:
    """Keep the columns of a history that are drawn."""
    columns = "axial_strain", "stress_ratio", "volumetric_strain", "residual", "evaluations"
    data = np.genfromtxt(history, delimiter=",", names=True)
    rows = np.column_stack([data[column] for column in columns])
    keep(f"localisation_{name}", ",".join(columns), rows)


#: Runs of the benchmark, which take hours: folder below results/, name of the table.
LONG = {
    "localisation/2x4_Q8_2x2": "2x4_q8",
    "localisation/6x10_Q4_2x2": "6x10_q4",
    "localisation/10x15_Q4_2x2": "10x15_q4",
    "localisation/12x20_Q4_2x2_varied_0.05": "12x20_q4_varied",
    "localisation/6x10_Q8_3x3_varied_0.05": "6x10_q8_3x3_varied",
}


def run_localisation() -> None:
    run_roughness()
    run_spectrum()
    for folder, name in LONG.items():
        history = RESULTS / folder / "history.csv"
        if history.exists():
            keep_history(history, name)
        else:
            print(f"results/{folder}: not there, drawn as kept")
    hexagonal = RESULTS / "hexagonal.h5"
    save_packing(hexagonal, hexagonal_packing(400))
    words = "--mesh 2 4 --element Q4 --formulation small --strain 0.1 --quiet --path-following"
    for name in ("none", "crossing"):
        folder = RESULTS / f"hexagonal_{name}"
        where = "--packing", str(hexagonal), "--output", str(folder)
        python("demos/biaxial.py", *words.split(), name, *where)
        keep_history(folder / "history.csv", f"hexagonal_{name}")


def draw_localisation() -> None:
    draw_roughness()
    draw_spectrum()
    draw_runs()
    draw_hexagonal()


ALL = {"localisation": (run_localisation, draw_localisation)}
