"""`femxdem packing`: prepare, look at, draw, convert; is it representative?"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np

from .. import contact_arguments, lab_plots, paraview, representativity, terminal, writing
from ..dem.files import save_packing
from ..dem.homogenisation import stress
from ..dem.lattices import hexagonal_packing
from ..dem.packing import Packing
from ..dem.preparation import NotReached, library
from ..dem.reproducible import inverse, product
from ..dem.structure import structure_of
from . import common


def add(commands) -> None:
    """The subcommands into a parser's."""
    parser = commands.add_parser("packing", help="prepare, look at, draw, convert packings")
    below = parser.add_subparsers(metavar="WHAT", required=True, parser_class=type(parser))
    _add_prepare(below)
    command = below.add_parser("info", help="what is in these files", description=info.__doc__)
    command.add_argument("files", type=Path, nargs="+", metavar="FILE")
    command.set_defaults(run=info)
    command = below.add_parser("plot", help="a picture", description=plot.__doc__)
    command.add_argument("file", type=Path)
    command.add_argument("--output", type=Path, help="png, pdf or svg  (default: FILE's name .png)")
    command.add_argument("--title")
    command.set_defaults(run=plot)
    _add_convert(below)
    _add_representativity(below)


def _add_prepare(below) -> None:
    parser = below.add_parser("prepare", help="a new one", description=prepare.__doc__)
    parser.add_argument("--output", type=Path, default=Path("packing.h5"), help="HDF5 file")
    parser.add_argument(
        "--count", type=int, default=1,
        help="packings: the same grains, other seeds; files get numbers",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=1, help="of the first packing")
    grains = parser.add_argument_group("grains")
    common.add_grains(grains)
    grains.add_argument("--grain-density", type=float, default=2650.0, help="kg/m3")
    grains.add_argument(
        "--thickness",
        type=float,
        help="of disks, m  (default: ten mean diameters, 0.1 for 3 to 7 mm)",
    )
    contact_arguments.add_contact_law(grains)
    state = parser.add_argument_group("state")
    state.add_argument(
        "--arrangement", choices=("random", "hexagonal"), default="random",
        help="hexagonal: equal grains, as large as the mean of --radii, on a lattice",
    )  # fmt: skip
    state.add_argument(
        "--pressure", type=float, nargs="+", default=[1e5], metavar="P",
        help="Pa, compression positive; one value per axis makes the stress anisotropic",
    )  # fmt: skip
    common.add_density(state)
    state.add_argument("--void-ratio", type=float, help="to be reached by the right friction")
    state.add_argument("--tolerance", type=float, default=1e-3, help="on stress over pressure")
    common.add_quiet(parser)
    parser.set_defaults(run=prepare)


def prepare(args: argparse.Namespace) -> int:
    """A random or hexagonal packing under a pressure, or a library of several equal ones."""
    if args.void_ratio is not None and (
        args.density != "dense" or args.compaction_friction is not None
    ):
        raise ValueError("--void-ratio is reached by the compaction friction; do not give that too")
    if args.arrangement == "hexagonal" and args.count > 1:
        raise ValueError("--count: all hexagonal packings are the same; one is enough")
    names = ("file", "void ratio", "coordination", "rattlers", "anisotropy F_a")
    rows, voids = [], []
    paths = _numbered(args.output, args.count)
    with terminal.LoadProgress(args.count, args.quiet, "preparing") as progress:
        for path, packing in zip(paths, _packings(args), strict=True):
            save_packing(path, packing)
            found = structure_of(packing)
            voids.append(found.void_ratio)
            rows.append((
                str(path), f"{found.void_ratio:.4f}", f"{found.coordination_number:.3f}",
                f"{found.rattlers:.1%}", f"{found.fabric_anisotropy:.3f}",
            ))  # fmt: skip
            progress.show(len(rows), f"{path}  void ratio {found.void_ratio:.4f}")
    if args.count > 1:
        spread = f"{np.mean(voids):.4f} ± {np.std(voids, ddof=1):.4f}"
        rows.append(("mean ± standard deviation", spread, "", "", ""))
    terminal.print_columns("Prepared", names, rows, args.quiet)
    return 0


def _numbered(path: Path, count: int) -> list[Path]:
    if count < 1:
        raise ValueError(f"--count must be 1 or more, got {count}")
    if count == 1:
        return [path]
    return [path.with_name(f"{path.stem}-{k:03d}{path.suffix}") for k in range(1, count + 1)]


def _packings(args: argparse.Namespace) -> Iterator[Packing]:
    """The packings asked for; what was reached is kept where a target is not."""
    values = {
        "grains": args.grains, "law": contact_arguments.contact_law_for(args),
        "pressure": common.pressure_of(args.pressure, args.dim), "density": args.grain_density,
        "thickness": args.thickness, "dim": args.dim, "tolerance": args.tolerance,
    }  # fmt: skip
    try:
        if args.arrangement == "hexagonal":
            yield hexagonal_packing(radius=0.5 * sum(args.radii), **values)
            return
        values |= {"radii": common.sizes_of(args)}
        if args.void_ratio is None:
            values |= {"compaction_friction": common.compaction_friction_of(args)}
        yield from library(args.count, args.seed, args.void_ratio, **values)
    except NotReached as error:
        if error.packing is None:
            raise
        kept = args.output.with_name(f"{args.output.stem}-reached{args.output.suffix}")
        save_packing(kept, error.packing)
        raise NotReached(f"{error}; what was reached is in {kept}", error.packing) from None


def info(args: argparse.Namespace) -> int:
    """Grains, contact law, stress and structure of packings."""
    for path in args.files:
        terminal.print_table(str(path), facts(common.read_packing(path)))
    return 0


def facts(packing: Packing) -> dict[str, str]:
    """What a reader would want to know of a packing, ready to print."""
    found, kind = structure_of(packing), "disks" if packing.dim == 2 else "spheres"
    law = ", ".join(
        f"{field.name} {value:.6g}" if isinstance(value, float) else f"{field.name} {value}"
        for field in fields(packing.law)
        if (value := getattr(packing.law, field.name)) is not None
    )
    millimetres = 1e3 * packing.radii
    sigma = -1e-3 * stress(packing)
    rows = {
        "grains": f"{packing.size} {kind}, {packing.density:g} kg/m3",
        "radii": f"{millimetres.min():.3g} to {millimetres.max():.3g} mm,"
        f" mean {millimetres.mean():.3g} mm",
        "contact law": f"{type(packing.law).__name__}: {law}",
        "box": " | ".join(" ".join(f"{1e3 * x:.5g}" for x in row) for row in packing.box) + " mm",
        "void ratio": f"{found.void_ratio:.4f}",
        "coordination number": f"{found.coordination_number:.3f},"
        f" without rattlers {found.bearing_coordination_number:.3f}",
        "rattlers": f"{found.rattlers:.1%}",
        "sliding contacts": f"{found.sliding:.1%}",
        "fabric anisotropy": f"{found.fabric_anisotropy:.3f}",
        "largest overlap": f"{found.largest_overlap:.2e} of a diameter",
        "stress, compression positive": " | ".join(
            " ".join(f"{x:.4g}" for x in row) for row in sigma
        )
        + " kPa",
    }
    return rows if packing.dim == 3 else rows | {"thickness": f"{packing.thickness:g} m"}


def plot(args: argparse.Namespace) -> int:
    """Grains with force chains, rose of contact normals with its fit, contact numbers."""
    packing = common.read_packing(args.file)
    path = _picture(args.output or args.file.with_suffix(".png"))
    lab_plots.save_packing_picture(path, packing, args.title)
    print(path)
    return 0


def _picture(path: Path) -> Path:
    if path.suffix not in (".png", ".pdf", ".svg"):
        raise ValueError(f"{path}: a picture ends in .png, .pdf or .svg")
    return path


def _add_convert(below) -> None:
    parser = below.add_parser(
        "convert", help="to and from other formats", description=convert.__doc__
    )
    parser.add_argument("file", type=Path, help=".h5, or .csv with x_m, y_m, [z_m,] radius_m")
    parser.add_argument("target", type=Path, help=".vtp (ParaView), .csv, or .h5")
    table = parser.add_argument_group("what a table of grains does not say")
    table.add_argument("--box", type=float, nargs="+", metavar="SIDE", help="2 or 3 sides, m")
    table.add_argument("--grain-density", type=float, default=2650.0, help="kg/m3")
    table.add_argument("--thickness", type=float, default=0.1, help="of disks, m")
    contact_arguments.add_contact_law(table)
    parser.set_defaults(run=convert)


def convert(args: argparse.Namespace) -> int:
    """A packing for ParaView or a table of its grains; or a packing from such a table.

    A table holds no tangential forces: a packing read from one starts without any.
    """
    if args.file.suffix == ".csv":
        packing = _read_table(args)
    else:
        packing = common.read_packing(args.file)
    if args.target.suffix == ".vtp":
        paraview.save_vtp(args.target, packing)
    elif args.target.suffix == ".csv":
        _write_table(args.target, packing)
    elif args.target.suffix == ".h5":
        save_packing(args.target, packing)
    else:
        raise ValueError(f"{args.target}: unknown format; choose .vtp, .csv or .h5")
    print(args.target)
    return 0


def _write_table(path: Path, packing: Packing) -> None:
    places = product(packing.positions, packing.box.T)
    names = (*(f"{axis}_m" for axis in "xyz"[: packing.dim]), "radius_m")
    values = np.column_stack([places, packing.radii]).tolist()
    writing.write_csv(path, names, [dict(zip(names, row, strict=True)) for row in values])


def _read_table(args: argparse.Namespace) -> Packing:
    """A packing in a rectangular box from a table of grains; ValueError for what is none."""
    if args.box is None or len(args.box) not in (2, 3):
        raise ValueError(f"{args.file}: a table of grains needs its --box, 2 or 3 sides (m)")
    dim = len(args.box)
    wanted = (*(f"{axis}_m" for axis in "xyz"[:dim]), "radius_m")
    try:
        with open(args.file, newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        values = np.array([[float(row[name]) for name in wanted] for row in rows])
    except KeyError as missing:
        raise ValueError(f"{args.file}: there is no column {missing}") from None
    except (TypeError, ValueError):
        raise ValueError(f"{args.file}: a cell is empty or no number") from None
    if len(values) == 0:
        raise ValueError(f"{args.file}: the table has no grains")
    box = np.diag(args.box)
    positions = product(values[:, :dim], inverse(box).T)
    try:
        return Packing(
            box, positions, values[:, dim], contact_arguments.contact_law_for(args),
            args.grain_density, args.thickness if dim == 2 else 1.0,
        )  # fmt: skip
    except ValueError as error:
        raise ValueError(f"{args.file}: {error}") from None


def _add_representativity(below) -> None:
    parser = below.add_parser(
        "representativity", help="how many grains are enough", description=study.__doc__
    )
    defaults = representativity.Study()
    parser.add_argument("--output", type=Path, default=Path("results/representativity"))
    parser.add_argument("--disks", type=int, nargs="*", default=list(defaults.disks), metavar="N")
    parser.add_argument(
        "--spheres", type=int, nargs="*", default=list(defaults.spheres), metavar="N"
    )
    parser.add_argument("--seeds", type=int, default=defaults.seeds, help="packings of each size")
    parser.add_argument("--pressure", type=float, default=defaults.pressure, help="Pa")
    parser.add_argument("--strain", type=float, default=defaults.strain, help="axial, of the tests")
    parser.add_argument("--quick", action="store_true", help="few small packings")
    common.add_threads(parser)
    common.add_quiet(parser)
    parser.set_defaults(run=study)


def study(args: argparse.Namespace) -> int:
    """Packings of several sizes and seeds in drained compression: structure, stiffness, strength.

    Rows that the table in the output folder has already are not computed again.
    """
    values = representativity.Study(
        tuple(args.disks), tuple(args.spheres), args.seeds, args.pressure, args.strain
    )
    if args.quick:
        values = representativity.QUICK
    threads = common.threads_of(args)
    cases = values.cases
    with terminal.LoadProgress(len(cases), args.quiet) as progress:
        rows = representativity.run(
            values, args.output, threads,
            lambda done, row: progress.show(done, representativity.describe(row)),
        )  # fmt: skip
    representativity.draw(values, args.output, rows)
    for dim, kind in ((2, "disks"), (3, "spheres")):
        names, table = representativity.table(rows, dim)
        if len(names) > 1:
            title = f"{kind.capitalize()}, mean ± standard deviation over the seeds"
            terminal.print_columns(title, names, table, args.quiet)
    writing.write_csv(args.output / "summary.csv", *representativity.summary(rows))
    return 0
