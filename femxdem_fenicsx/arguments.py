"""Arguments that the demos share, and what they ask for: a packing, a law, criteria."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

from . import contact_arguments, script
from .dem.accuracy import PRESETS, Accuracy, preset
from .dem.files import load_packing
from .dem.packing import Packing
from .dem.preparation import random_packing
from .dem.tangents import OPERATORS, operator
from .fem.collective import together
from .fem.elements import element, names
from .fem.problem import Convergence
from .homogenised_law import HomogenisedLaw


def parser(description: str) -> argparse.ArgumentParser:
    """A parser that shows the defaults; what it does not know goes to PETSc."""
    return argparse.ArgumentParser(
        description=description,
        epilog="Any other option goes to PETSc, e.g. -femxdem_snes_monitor.",
        formatter_class=script.HelpFormatter,
    )


def add_discretisation(
    specimen, dim: int, cells: Sequence[int], kind: str, formulations: Sequence[str]
) -> None:
    """--mesh, --element, --points and --formulation, into the group of the specimen."""
    axes = ("NX", "NY", "NZ")[:dim]
    *others, last = names(dim)
    specimen.add_argument("--mesh", type=int, nargs=dim, default=tuple(cells), metavar=axes)
    specimen.add_argument("--element", default=kind, help=f"{', '.join(others)} or {last}")
    specimen.add_argument("--points", help="quadrature, e.g. 3x3  (default: the element's)")
    specimen.add_argument("--formulation", default="finite", help=", ".join(formulations))


def add_grains(parser: argparse.ArgumentParser, count: int, noun: str) -> argparse._ArgumentGroup:
    """What `packing_for` reads."""
    grains = parser.add_argument_group("grains")
    grains.add_argument("--packing", type=Path, help="read this file instead of preparing one")
    grains.add_argument("--grains", type=int, default=count, help=f"number of {noun}")
    grains.add_argument(
        "--radii", type=float, nargs=2, default=(3e-3, 7e-3), metavar=("MIN", "MAX"), help="m"
    )
    grains.add_argument("--seed", type=int, default=1)
    contact_arguments.add_contact_law(grains)
    grains.add_argument(
        "--compaction-friction", type=float, default=0.0, help="0: dense, 0.2: loose"
    )
    return grains


def add_compression(parser: argparse.ArgumentParser, strain: float) -> None:
    """Lateral pressure, axial strain and step."""
    loading = parser.add_argument_group("loading")
    loading.add_argument("--pressure", type=float, default=1e5, help="on the sides, Pa")
    loading.add_argument("--strain", type=float, default=strain, help="axial strain to reach")
    loading.add_argument("--step", type=float, default=1e-3, help="axial strain of a load step")


def add_solution(parser: argparse.ArgumentParser) -> None:
    """What `law_for` and `convergence_of` read."""
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


def add_output(parser: argparse.ArgumentParser, folder: str) -> None:
    """Where results go."""
    output = parser.add_argument_group("output")
    output.add_argument("--output", type=Path, default=Path(folder), help="folder")
    output.add_argument("--quiet", action="store_true", help="no progress, no table")


def check(args: argparse.Namespace, dim: int, formulations: Sequence[str]) -> None:
    """What would otherwise be found out only after the packing has been prepared.

    Args:
        args: of all the groups above.
        dim: of the mesh.
        formulations: names to choose from.

    Raises:
        ValueError: with the one thing that is wrong.
    """
    if args.formulation not in formulations:
        known = ", ".join(formulations)
        raise ValueError(f"unknown formulation '{args.formulation}'; choose from {known}")
    element(args.element, args.points).check_dim(dim)
    accuracy_of(args)
    operator(args.operator)
    if not 0 < args.step <= args.strain < 1:
        raise ValueError(
            f"--step {args.step} and --strain {args.strain}: need 0 < step <= strain < 1"
        )
    if not args.pressure > 0:
        raise ValueError(f"--pressure {args.pressure}: the lateral pressure must be positive")


def packing_for(args: argparse.Namespace, comm: MPI.Comm, dim: int) -> Packing:
    """The packing of disks (dim 2) or spheres (3), read or prepared by rank 0, on all ranks.

    Random grains are thrown into a wide periodic box, which is compressed to the pressure of the
    test. Their contacts are linear with Coulomb friction.

    Raises ValueError for another dimension, a file that is no such packing, and arguments that
    make no packing.
    """
    if dim not in (2, 3):
        raise ValueError(f"grains of {dim} dimensions: they are disks (2) or spheres (3)")

    def prepare() -> Packing | None:
        if comm.rank > 0:
            return None
        if args.packing is not None:
            return load_packing(args.packing, dim)
        law = contact_arguments.contact_law(args)
        return random_packing(
            args.grains,
            args.radii,
            law,
            args.pressure,
            args.compaction_friction,
            args.seed,
            dim=dim,
        )

    return comm.bcast(together(comm, prepare))


def accuracy_of(args: argparse.Namespace) -> Accuracy:
    """The preset, with the time step that was asked for."""
    chosen = preset(args.accuracy)
    return chosen if args.time_step is None else chosen.but(time_step=args.time_step)


def law_for(
    args: argparse.Namespace, packing: Packing, size: int, comm: MPI.Comm
) -> HomogenisedLaw:
    """A copy of the packing at each of `size` material points of this rank."""
    threads = script.threads_per_rank(comm) if args.threads is None else args.threads
    return HomogenisedLaw(packing, size, accuracy_of(args), args.operator, threads)


def convergence_of(args: argparse.Namespace) -> Convergence:
    """The criteria of a load step."""
    return Convergence(args.tolerance, args.displacement_tolerance, args.max_iterations)
