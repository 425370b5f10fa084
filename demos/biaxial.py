# # Drained biaxial compression of a granular specimen
#
# A specimen of 50 mm x 100 mm stands between smooth plates under a lateral pressure of 100 kPa.
# The upper plate moves down; past the peak the deformation localises in a shear band
# (Guo and Zhao 2014, section 4; Desrues et al. 2019, section 4.5). This demo shows how to
#
# - prepare a packing of grains, or read one from a file
# - let one copy of it answer for the material at every quadrature point
# - solve the equilibrium of the specimen step by step, with cut steps where it is needed
# - write fields, a table and pictures
#
# Run it with `.venv/bin/python demos/biaxial.py --help`, or under `mpirun -n 2`.

import argparse
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from femxdem_fenicsx import plotting, script
from femxdem_fenicsx.dem.accuracy import PRESETS, Accuracy, preset
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.files import load_packing, save_packing
from femxdem_fenicsx.dem.packing import Packing
from femxdem_fenicsx.dem.preparation import random_packing
from femxdem_fenicsx.dem.tangents import OPERATORS, operator
from femxdem_fenicsx.fem.collective import together
from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.output import Fields, History, writable_folder
from femxdem_fenicsx.fem.problem import Convergence, Problem
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from femxdem_fenicsx.fem.stepping import LoadStepping, Outcome, StepRecord, walk
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from forms import first_gradient
from meshes.rectangle import BOTTOM, LEFT, RIGHT, TOP, rectangle, sides, vertex_near

#: Largest strain of a point in one load step, over the step's axial strain: beyond it, cut.
LARGEST_INCREMENT = 30
FORMULATIONS = {"small": first_gradient.small, "finite": first_gradient.finite}


# ## The scene
#
# Everything that a user may want to change has an option.


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Drained biaxial compression, FEM x DEM.",
        epilog="Any other option goes to PETSc, e.g. -femxdem_snes_monitor.",
        formatter_class=script.HelpFormatter,
    )
    specimen = parser.add_argument_group("specimen")
    specimen.add_argument("--width", type=float, default=0.05, help="m")
    specimen.add_argument("--height", type=float, default=0.1, help="m")
    specimen.add_argument("--mesh", type=int, nargs=2, default=(8, 16), metavar=("NX", "NY"))
    specimen.add_argument("--element", default="Q4", help="Q4, Q8, Q9 or T6")
    specimen.add_argument("--points", help="quadrature, e.g. 3x3  (default: the element's)")
    specimen.add_argument("--formulation", default="finite", help=", ".join(FORMULATIONS))
    grains = parser.add_argument_group("grains")
    grains.add_argument("--packing", type=Path, help="read this file instead of preparing one")
    grains.add_argument("--grains", type=int, default=400, help="number of disks")
    grains.add_argument(
        "--radii", type=float, nargs=2, default=(3e-3, 7e-3), metavar=("MIN", "MAX"), help="m"
    )
    grains.add_argument("--seed", type=int, default=1)
    grains.add_argument(
        "--friction", type=float, default=float(np.tan(0.5)), help="of the contacts"
    )
    grains.add_argument("--modulus", type=float, default=6e8, help="E_c of the contacts, Pa")
    grains.add_argument("--stiffness-ratio", type=float, default=0.8, help="k_t / k_n")
    grains.add_argument("--cohesion", type=float, default=0.0, help="of a contact, N")
    grains.add_argument(
        "--compaction-friction", type=float, default=0.0, help="0: dense, 0.2: loose"
    )
    loading = parser.add_argument_group("loading")
    loading.add_argument("--pressure", type=float, default=1e5, help="on the sides, Pa")
    loading.add_argument("--strain", type=float, default=0.035, help="axial strain to reach")
    loading.add_argument("--step", type=float, default=1e-3, help="axial strain of a load step")
    solution = parser.add_argument_group("solution")
    solution.add_argument("--accuracy", default="balanced", help=", ".join(PRESETS))
    solution.add_argument(
        "--time-step", type=float, help="share of the stability limit  (default: the preset's)"
    )
    solution.add_argument("--operator", default="UKO", help=", ".join(OPERATORS))
    solution.add_argument("--tolerance", type=float, default=1e-2, help="FNORM/RNORM")
    solution.add_argument(
        "--displacement-tolerance", type=float, help="on the last correction too (Guo-Zhao: 1e-2)"
    )
    solution.add_argument("--max-iterations", type=int, default=20)
    solution.add_argument(
        "--looser-tolerance", type=float, default=5e-2, help="for steps that cannot be cut more"
    )
    solution.add_argument("--threads", type=int, help="per rank  (default: its share of the cores)")
    output = parser.add_argument_group("output")
    output.add_argument("--output", type=Path, default=Path("results/biaxial"), help="folder")
    output.add_argument("--quiet", action="store_true", help="no progress, no table")
    return parser


# ## The material
#
# Rank 0 prepares the packing: disks thrown into a wide periodic box, which is compressed to the
# pressure of the test. Its contacts are linear with Coulomb friction.


def packing_for(args: argparse.Namespace, comm: MPI.Comm) -> Packing:
    def prepare() -> Packing | None:
        if comm.rank > 0:
            return None
        if args.packing is not None:
            return load_packing(args.packing)
        law = LinearContact(
            modulus=args.modulus,
            stiffness_ratio=args.stiffness_ratio,
            friction=args.friction,
            cohesion=args.cohesion,
        )
        return random_packing(
            args.grains, args.radii, law, args.pressure, args.compaction_friction, args.seed
        )

    return comm.bcast(together(comm, prepare))


def accuracy_of(args: argparse.Namespace) -> Accuracy:
    chosen = preset(args.accuracy)
    return chosen if args.time_step is None else chosen.but(time_step=args.time_step)


# ## The boundary value problem
#
# Find the displacement $u$ of a load step such that the internal forces of the stress
# $\sigma(F)$, $F = I + \nabla u$, balance the pressure on the sides. The stress comes from the
# grains through an external operator. The plates are smooth: they prescribe $u_y$ alone, and one
# point is held so that the specimen cannot drift sideways.


class Specimen:
    """The problem, and what is measured on its boundary."""

    def __init__(self, args: argparse.Namespace, packing: Packing, comm: MPI.Comm):
        kind = element(args.element, args.points)
        self.width, self.height = args.width, args.height
        self.mesh = rectangle(comm, args.width, args.height, *args.mesh, kind)
        self.points = QuadraturePoints(self.mesh, kind)
        threads = script.threads_per_rank(comm) if args.threads is None else args.threads
        self.law = HomogenisedLaw(
            packing, self.points.size, accuracy_of(args), args.operator, threads
        )
        u = fem.Function(kind.space(self.mesh))
        F = first_gradient.deformation_gradient(u)
        sigma = ExternalOperator(F, self.law, self.points, LARGEST_INCREMENT * args.step)

        tags = sides(self.mesh, args.width, args.height)
        ds = kind.ds(self.mesh, tags)
        p = fem.Constant(self.mesh, args.pressure)
        residual, jacobian = FORMULATIONS[args.formulation](
            u, sigma.stress, sigma.tangent, kind.dx(self.mesh), [(p, ds((LEFT, RIGHT)))]
        )

        V_x, V_y = u.function_space.sub(0), u.function_space.sub(1)
        self.descent, zero = fem.Constant(self.mesh, 0.0), fem.Constant(self.mesh, 0.0)
        self.top = fem.locate_dofs_topological(V_y, 1, tags.find(TOP))
        bottom = fem.locate_dofs_topological(V_y, 1, tags.find(BOTTOM))
        held = fem.locate_dofs_topological(V_x, 0, vertex_near(self.mesh, args.width / 2, 0.0))
        bcs = [
            fem.dirichletbc(self.descent, self.top, V_y),
            fem.dirichletbc(zero, bottom, V_y),
            fem.dirichletbc(zero, held, V_x),
        ]
        convergence = Convergence(args.tolerance, args.displacement_tolerance, args.max_iterations)
        self.problem = Problem(u, residual, jacobian, sigma, bcs, convergence)
        self.area = self.volume()

    def compress(self, start: float, end: float) -> None:
        """Let the plate go from one axial strain to another, both of the first height."""
        self.descent.value = -(end - start) * self.height

    def volume(self) -> float:
        """Of the specimen, m3 per metre of thickness."""
        return self.mesh.comm.allreduce(float(self.points.volumes().sum()))

    def axial_stress(self, strain: float) -> float:
        """Force on the upper plate over the mean width, Pa, compression positive."""
        mean_width = self.volume() / (self.height * (1 - strain))
        return -self.problem.reaction(self.top) / mean_width

    def mean(self, at_points: np.ndarray) -> float:
        """Volume average of a scalar (size,) over the specimen."""
        volumes = self.points.volumes()
        total = self.mesh.comm.allreduce(np.array([volumes @ at_points, volumes.sum()]))
        return float(total[0] / total[1])


# ## Loading
#
# `walk` goes along the load path and cuts steps where Newton's iteration fails. After every
# accepted step the observer writes a row and the fields.

COLUMNS = (
    "step", "axial_strain", "stress_ratio", "axial_stress_Pa", "volumetric_strain", "void_ratio",
    "iterations", "evaluations", "residual", "converged", "cuts", "dem_steps", "unfinished_holds",
    "worst_unbalance", "failed_points", "seconds",
)  # fmt: skip


def fields_of(law: HomogenisedLaw) -> dict[str, np.ndarray]:
    return {
        "stress": law.stress,
        "deviatoric_strain": law.deviatoric_strain,
        "void_ratio": law.void_ratio,
        "coordination_number": law.coordination_number,
        "fabric_anisotropy": law.fabric_anisotropy,
    }


def row_of(specimen: Specimen, record: StepRecord, pressure: float) -> dict[str, float]:
    comm, tally = specimen.mesh.comm, specimen.law.tally
    axial = specimen.axial_stress(record.load)
    return {
        "step": record.number,
        "axial_strain": record.load,
        "stress_ratio": axial / pressure,
        "axial_stress_Pa": axial,
        "volumetric_strain": specimen.volume() / specimen.area - 1.0,
        "void_ratio": specimen.mean(specimen.law.void_ratio),
        "iterations": record.iterations,
        "evaluations": record.evaluations,
        "residual": record.residual,
        "converged": record.converged,
        "cuts": record.cuts,
        "dem_steps": comm.allreduce(tally.steps),
        "unfinished_holds": comm.allreduce(tally.unfinished),
        "worst_unbalance": comm.allreduce(tally.worst_unbalance, MPI.MAX),
        "failed_points": comm.allreduce(int(specimen.law.failed.sum())),
        "seconds": record.seconds,
    }


@dataclass
class Run:
    """How the load path ended, a row per step, and the seconds that solving took."""

    outcome: Outcome
    rows: list[dict[str, float]]
    solving: float


def load(specimen: Specimen, args: argparse.Namespace) -> Run:
    comm, folder = specimen.mesh.comm, args.output
    rows: list[dict[str, float]] = []
    observing = 0.0
    displacement = specimen.problem.motion.displacement
    with (
        script.LoadProgress(comm, args.strain, args.quiet) as progress,
        Fields(folder / "biaxial", specimen.points, displacement) as fields,
        History(comm, folder / "history.csv", COLUMNS) as history,
    ):
        fields.write(0.0, fields_of(specimen.law))

        def observe(record: StepRecord) -> None:
            nonlocal observing
            started = perf_counter()
            rows.append(row_of(specimen, record, args.pressure))
            history.write(rows[-1])
            fields.write(record.load, fields_of(specimen.law))
            progress.show(
                record.load,
                f"strain {record.load:.2%}  stress ratio {rows[-1]['stress_ratio']:.3f}"
                f"  iterations {record.iterations}",
            )
            observing += perf_counter() - started

        stepping = LoadStepping(args.step, looser_limit=args.looser_tolerance)
        started = perf_counter()
        outcome = walk(specimen.problem, specimen.compress, args.strain, stepping, observe)
        solving = perf_counter() - started - observing
    return Run(outcome, rows, solving)


# ## Results


def pictures(specimen: Specimen, rows: list[dict[str, float]], folder: Path) -> None:
    law, points, comm = specimen.law, specimen.points, specimen.mesh.comm
    strain = law.deviatoric_strain
    cells = points.gather(
        points.cell_corners(), points.cell_means(strain), points.cell_means(law.void_ratio)
    )
    inside = packing_at_extreme(comm, law, strain)
    outside = packing_at_extreme(comm, law, -strain)

    def save() -> None:
        if comm.rank > 0:
            return
        corners, deviatoric_strain, void_ratio = cells
        plotting.save_fields(
            folder / "fields.png",
            corners,
            [("deviatoric strain", deviatoric_strain), ("void ratio", void_ratio)],
        )
        chains = [("in the band", inside), ("outside the band", outside)]
        plotting.save_force_chains(folder / "force_chains.png", chains)
        for name, packing in chains:
            save_packing(folder / f"packing_{name.split()[0]}.h5", packing)
        if rows:
            columns = [[row[name] for row in rows] for name in COLUMNS]
            table = dict(zip(COLUMNS, map(np.array, columns), strict=True))
            plotting.save_history(
                folder / "history.png",
                np.insert(table["axial_strain"], 0, 0.0),
                np.insert(table["stress_ratio"], 0, 1.0),
                np.insert(table["volumetric_strain"], 0, 0.0),
            )

    together(comm, save)


def packing_at_extreme(comm: MPI.Comm, law: HomogenisedLaw, values: np.ndarray) -> Packing:
    """The packing of the point where `values` is largest in the whole specimen, on every rank."""
    largest = float(values.max(initial=-np.inf))
    _, owner = max((value, -rank) for rank, value in enumerate(comm.allgather(largest)))
    packing = law.packing(int(values.argmax())) if comm.rank == -owner else None
    return comm.bcast(packing, root=-owner)


def summary(specimen: Specimen, run: Run, seconds: float) -> dict[str, str]:
    comm, tally = specimen.mesh.comm, specimen.law.tally
    outcome, rows = run.outcome, run.rows
    peak = max(rows, key=lambda row: row["stress_ratio"])
    angle = np.degrees(np.arcsin((peak["stress_ratio"] - 1) / (peak["stress_ratio"] + 1)))
    dem = comm.allreduce(tally.seconds + tally.tangent_seconds, MPI.MAX)
    holds = comm.allreduce(tally.unfinished) / max(comm.allreduce(tally.packings), 1)
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
        "holds that ended at their limit": f"{holds:.1%}",
        "worst unbalance, largest overlap": (
            f"{comm.allreduce(tally.worst_unbalance, MPI.MAX):.1e},"
            f" {comm.allreduce(tally.worst_overlap, MPI.MAX):.1e}"
        ),
        "failed points": f"{rows[-1]['failed_points']}",
        "seconds in DEM / FEM / the rest": (
            f"{dem:.1f} / {run.solving - dem:.1f} / {seconds - run.solving:.1f}"
        ),
    }


def main(comm: MPI.Comm) -> int:
    started = perf_counter()
    args = script.parse(arguments(), comm)
    check(args)
    writable_folder(comm, args.output)
    packing = packing_for(args, comm)
    specimen = Specimen(args, packing, comm)
    specimen.first_void_ratio = packing.void_ratio
    done = load(specimen, args)
    pictures(specimen, done.rows, args.output)
    if done.rows:
        table = summary(specimen, done, perf_counter() - started)
        script.print_table(comm, "Drained biaxial compression", table, args.quiet)
    if done.outcome.lost_controllability:
        if comm.rank == 0:
            print(f"the load path ended early: {done.outcome.lost_controllability}")
        return script.LOST_CONTROLLABILITY
    return 0


def check(args: argparse.Namespace) -> None:
    """What would otherwise be found out only after the packing has been prepared."""
    if args.formulation not in FORMULATIONS:
        known = ", ".join(FORMULATIONS)
        raise ValueError(f"unknown formulation '{args.formulation}'; choose from {known}")
    element(args.element, args.points)
    accuracy_of(args)
    operator(args.operator)
    if not 0 < args.step <= args.strain < 1:
        raise ValueError(
            f"--step {args.step} and --strain {args.strain}: need 0 < step <= strain < 1"
        )
    if not args.pressure > 0:
        raise ValueError(f"--pressure {args.pressure}: the lateral pressure must be positive")


if __name__ == "__main__":
    script.run(main)
