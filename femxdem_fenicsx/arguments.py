"""Arguments that the demos share, and what they ask for: a packing, a law, criteria."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from . import contact_arguments, script
from .checkpoint import Checkpoint, Saving
from .collective import together
from .compression import FIELDS
from .dem.accuracy import PRESETS, Accuracy, preset
from .dem.files import load_packing, save_packing
from .dem.packing import Packing
from .dem.preparation import random_packing
from .dem.tangents import OPERATORS, operator
from .double_stress import one_parameter
from .fem.convergence import Convergence
from .fem.elements import MICRO_STRAINS, element, names
from .fem.path_following import Crossing
from .fem.quadrature_points import QuadraturePoints
from .fem.stepping import LoadStepping
from .homogenised_law import HomogenisedLaw
from .variability import Variability

if TYPE_CHECKING:
    from .distribution import DistributedLaw

#: What happens where the smallest step does not converge (docs/localisation.md).
PATH_FOLLOWING = {"none": {}, "crossing": {"crossing": Crossing()}, "indirect": {"indirect": True}}
GRADIENTS = ("first", "second")

#: What may change when a run is resumed: where it goes, how far, and how it is solved. The packing
#: is compared by what is in it, the accuracy by its numbers.
FREE = (
    "defaults", "output", "quiet", "resume", "checkpoint_every", "checkpoint_fails", "threads",
    "packing", "accuracy", "time_step", "strain", "step", "tolerance", "displacement_tolerance",
    "looser_tolerance", "max_iterations", "operator", "path_following",
)  # fmt: skip


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
    """--mesh, --element, --points, --formulation and --gradient, into the group of the specimen."""
    axes = ("NX", "NY", "NZ")[:dim]
    *others, last = names(dim)
    specimen.add_argument(
        "--mesh", type=int, nargs=dim, default=tuple(cells), metavar=axes, help="elements each way"
    )
    specimen.add_argument("--element", default=kind, help=f"{', '.join(others)} or {last}")
    specimen.add_argument("--points", help="quadrature, e.g. 3x3  (default: the element's)")
    specimen.add_argument("--formulation", default="finite", help=", ".join(formulations))
    specimen.add_argument("--gradient", default="first", help=", ".join(GRADIENTS))
    specimen.add_argument(
        "--second-gradient-modulus",
        type=float,
        metavar="D",
        help="N, with --gradient second  (the internal length goes with its square root)",
    )
    specimen.add_argument(
        "--micro-strain",
        help=f"{', '.join(MICRO_STRAINS)}, with --gradient second  (default: linear, Desrues' "
        "element; quadratic: for narrow bands)",
    )


def add_variability(specimen: argparse._ArgumentGroup) -> None:
    """What `variability_of` reads, into the group of the specimen."""
    specimen.add_argument(
        "--friction-variability",
        type=float,
        metavar="DELTA",
        help="half of the elements have contact friction lower, half higher by this",
    )
    specimen.add_argument("--variability-seed", type=int, default=1, help="which of them")
    specimen.add_argument(
        "--weak-element",
        type=int,
        metavar="NUMBER",
        help="this one alone, from 0, row by row from below: lower by DELTA",
    )


def variability_of(args: argparse.Namespace) -> Variability | None:
    """How friction varies from element to element, if it does."""
    if args.friction_variability is None:
        if args.weak_element is not None:
            raise ValueError("--weak-element needs --friction-variability DELTA")
        return None
    return Variability(args.friction_variability, args.weak_element, args.variability_seed)


def add_grains(parser: argparse.ArgumentParser, count: int, noun: str) -> argparse._ArgumentGroup:
    """What `packing_for` reads."""
    grains = parser.add_argument_group("grains")
    grains.add_argument("--packing", type=Path, help="read this file instead of preparing one")
    grains.add_argument("--grains", type=int, default=count, help=f"number of {noun}")
    grains.add_argument(
        "--radii", type=float, nargs=2, default=(3e-3, 7e-3), metavar=("MIN", "MAX"), help="m"
    )
    grains.add_argument("--seed", type=int, default=1, help="another one, another packing")
    contact_arguments.add_contact_law(grains)
    grains.add_argument(
        "--compaction-friction", type=float, default=0.0, help="0: dense, 0.2: loose"
    )
    return grains


#: The operator that wins, for disks and spheres (docs/operators.md).
DEFAULT_OPERATOR = "PSTLO-secant"


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
    solution.add_argument("--operator", default=DEFAULT_OPERATOR, help=f"{', '.join(OPERATORS)}")
    solution.add_argument("--tolerance", type=float, default=1e-2, help="FNORM/RNORM")
    solution.add_argument(
        "--displacement-tolerance", type=float, help="on the last correction too (Guo-Zhao: 1e-2)"
    )
    solution.add_argument("--max-iterations", type=int, default=20, help="of one step")
    solution.add_argument(
        "--looser-tolerance", type=float, default=5e-2, help="for steps that cannot be cut more"
    )
    solution.add_argument(
        "--path-following",
        default="none",
        help=f"where the smallest step does not converge: {', '.join(PATH_FOLLOWING)}",
    )
    solution.add_argument("--threads", type=int, help="per rank  (default: its share of the cores)")


def add_output(parser: argparse.ArgumentParser, folder: str) -> None:
    """Where results go."""
    output = parser.add_argument_group("output")
    output.add_argument("--output", type=Path, default=Path(folder), help="folder")
    known = ", ".join(HomogenisedLaw.FIELDS)
    output.add_argument(
        "--fields", nargs="*", default=FIELDS, metavar="NAME", help=f"for ParaView: of {known}"
    )
    output.add_argument("--quiet", action="store_true", help="no progress, no table")
    output.add_argument("--resume", action="store_true", help="go on from the last checkpoint")
    output.add_argument(
        "--checkpoint-every", type=int, metavar="STEPS", help="(default: every 10 minutes)"
    )
    output.add_argument(
        "--checkpoint-fails", default="go-on", choices=("go-on", "stop"), help="as on a full disk"
    )


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
    _check_gradient(args, dim)
    if unknown := set(args.fields) - set(HomogenisedLaw.FIELDS):
        known = ", ".join(HomogenisedLaw.FIELDS)
        raise ValueError(f"--fields {' '.join(sorted(unknown))}: choose from {known}")
    if args.path_following not in PATH_FOLLOWING:
        known = ", ".join(PATH_FOLLOWING)
        raise ValueError(f"unknown --path-following '{args.path_following}'; choose from {known}")
    variability_of(args)
    accuracy_of(args)
    convergence_of(args)
    operator(args.operator)
    stepping_of(args)
    if not 0 < args.step <= args.strain < 1:
        raise ValueError(
            f"--step {args.step} and --strain {args.strain}: need 0 < step <= strain < 1"
        )
    if not args.pressure > 0:
        raise ValueError(f"--pressure {args.pressure}: the lateral pressure must be positive")
    if args.checkpoint_every is not None and args.checkpoint_every < 1:
        raise ValueError(f"--checkpoint-every {args.checkpoint_every}: it must be 1 or more")


def _check_gradient(args: argparse.Namespace, dim: int) -> None:
    modulus = args.second_gradient_modulus
    if args.gradient not in GRADIENTS:
        raise ValueError(f"unknown gradient '{args.gradient}'; choose from {', '.join(GRADIENTS)}")
    if args.gradient == "first":
        if modulus is not None:
            raise ValueError("--second-gradient-modulus needs --gradient second")
        if args.micro_strain is not None:
            raise ValueError("--micro-strain needs --gradient second")
        return
    if modulus is None:
        raise ValueError("--gradient second needs --second-gradient-modulus D, in N")
    one_parameter(modulus, dim)
    element(args.element, args.points).check_second_gradient(args.micro_strain or "linear")
    if dim == 3 and args.formulation != "small":
        raise ValueError("second gradient in 3D: use --formulation small")


def packing_for(args: argparse.Namespace, comm: MPI.Comm, dim: int) -> Packing:
    """The packing of disks (dim 2) or spheres (3), read or prepared by rank 0, on all ranks.

    Random grains are thrown into a wide periodic box, which is compressed to the pressure of the
    test. Where their contact law has bonds, those that touch then are cemented.

    A run that is resumed has the packing of its checkpoint.

    Raises ValueError for another dimension, a file that is no such packing, and arguments that
    make no packing.
    """
    if dim not in (2, 3):
        raise ValueError(f"grains of {dim} dimensions: they are disks (2) or spheres (3)")

    saved = Checkpoint.last(comm, checkpoint_folder(args)) if args.resume else None

    def prepare() -> Packing | None:
        if comm.rank > 0:
            return None
        if saved is not None:
            return _saved_packing(saved, args.packing, dim)
        if args.packing is not None:
            return load_packing(args.packing, dim)
        return random_packing(
            args.grains,
            args.radii,
            contact_arguments.contact_law_for(args),
            args.pressure,
            args.compaction_friction,
            args.seed,
            dim=dim,
        )

    return comm.bcast(together(comm, prepare))


def checkpoint_folder(args: argparse.Namespace) -> Path:
    """Where the run keeps its checkpoints."""
    return args.output / "checkpoint"


def _saved_packing(saved: Checkpoint, given: Path | None, dim: int) -> Packing:
    """The packing of a checkpoint; ValueError where another one is given."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "packing.h5")
        path.write_bytes(saved.packing)
        packing = load_packing(path, dim)
    if given is not None and not packing.equals(load_packing(given, dim)):
        raise ValueError(f"{saved.path}: the checkpoint of another run: {given} is not its packing")
    return packing


def saving_of(args: argparse.Namespace, law: HomogenisedLaw | DistributedLaw) -> Saving:
    """How the run is saved and resumed: it must share all arguments but those in `FREE`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "packing.h5")
        save_packing(path, law.response.committed.template)
        packing = path.read_bytes()
    scene = {name: value for name, value in vars(args).items() if name not in FREE}
    scene |= {f"accuracy: {name}": value for name, value in asdict(accuracy_of(args)).items()}
    defaults = {f"accuracy: {field.name}": field.default for field in fields(Accuracy)}
    return Saving(
        checkpoint_folder(args),
        _told(scene),
        packing,
        _told(defaults | getattr(args, "defaults", {})),
        args.checkpoint_every,
        args.resume,
        args.checkpoint_fails == "stop",
    )


def _told(values: Mapping[str, object]) -> dict[str, str]:
    """Values as text; a default tuple is the same as a list that was given."""
    return {
        name: str(list(value) if isinstance(value, tuple) else value)
        for name, value in values.items()
    }


def accuracy_of(args: argparse.Namespace) -> Accuracy:
    """The preset, with the time step that was asked for."""
    chosen = preset(args.accuracy)
    return chosen if args.time_step is None else chosen.but(time_step=args.time_step)


def law_for(
    args: argparse.Namespace, packing: Packing, points: QuadraturePoints, comm: MPI.Comm
) -> HomogenisedLaw | DistributedLaw:
    """A copy of the packing at each of the points; on several ranks each has a home rank.

    Raises ValueError for friction that cannot vary so.
    """
    threads = script.threads_per_rank(comm) if args.threads is None else args.threads

    variability, per_cell = variability_of(args), points.element.points_per_cell
    by_element = None
    if variability is not None:
        elements = comm.allreduce(len(points.cells))
        by_element = variability.friction(packing.law.friction, elements)

    def make(numbers: np.ndarray) -> HomogenisedLaw:
        friction = None if by_element is None else by_element[numbers // per_cell]
        return HomogenisedLaw(
            packing, len(numbers), accuracy_of(args), args.operator, threads, friction=friction
        )

    if comm.size == 1:
        return make(points.index)
    from .distribution import DistributedLaw

    return DistributedLaw(comm, points.index, make)


def convergence_of(args: argparse.Namespace) -> Convergence:
    """The criteria of a load step."""
    return Convergence(args.tolerance, args.displacement_tolerance, args.max_iterations)


def stepping_of(args: argparse.Namespace) -> LoadStepping:
    """Sizes of load steps, and what happens where the smallest does not converge."""
    return LoadStepping(
        args.step,
        looser_limit=args.looser_tolerance,
        **PATH_FOLLOWING[args.path_following],
    )
