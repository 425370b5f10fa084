"""`femxdem tradeoff`: what settings cost in speed and buy in accuracy, on a packing of the user."""

from __future__ import annotations

import argparse
from pathlib import Path

from .. import critical_state, lab_plots, terminal, tradeoff, writing
from . import common

COLUMNS = (
    "setting", "value", "dem_steps", "rms_stress_error", "spread_over_packings",
    "void_ratio_error", "peak_error", "last_error", "curve_error", "seconds",
)  # fmt: skip


#: Of the critical state, in a file of its own.
CRITICAL_COLUMNS = (
    "accuracy", "inertial_number", "tolerance", "packings", "dem_steps", "pressure_Pa",
    "pressure_standard_error_Pa", "friction_angle_deg", "friction_angle_standard_error_deg",
    "pressure_error", "pressure_error_standard_error",
)  # fmt: skip


def add(commands) -> None:
    """The subcommand into a parser's."""
    parser = commands.add_parser(
        "tradeoff", help="speed for accuracy, setting by setting", description=run.__doc__
    )
    parser.add_argument("--packing", type=Path, required=True, help="HDF5 file")
    path = parser.add_argument_group("strain path")
    path.add_argument("--increments", type=int, default=20)
    path.add_argument("--step", type=float, default=1e-3, help="axial strain of an increment")
    path.add_argument("--directions", type=int, default=4, help="of the compression")
    path.add_argument(
        "--lateral", type=float, default=0.8, help="extension over the axial compression"
    )
    parser.add_argument(
        "--packings", type=int, default=5, help="this one and others of the same grains"
    )
    critical = parser.add_argument_group("critical state at constant volume")
    critical.add_argument(
        "--critical-packings", type=int,
        help="of the same grains  (default: 32, 2 with --quick)",
    )  # fmt: skip
    critical.add_argument(
        "--void-ratio", type=float,
        help="that is kept  (default: what simple shear under the packing's pressure comes to)",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="fewer values, less shear")
    parser.add_argument("--output", type=Path, default=Path("results/tradeoff"), help="folder")
    common.add_threads(parser)
    common.add_quiet(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """One setting after the other is changed, and the packing compared with a very slow run.

    Writes a table, a picture of error against cost, and a summary with one sentence per setting.
    """
    if args.packings < 1:
        raise ValueError(f"--packings must be 1 or more, got {args.packings}")
    if args.critical_packings is not None and args.critical_packings < 2:
        raise ValueError(f"--critical-packings must be 2 or more, got {args.critical_packings}")
    if args.void_ratio is not None:
        critical_state.Shear(args.void_ratio)  # before anything is computed
    path = tradeoff.Path(
        args.increments, args.step, args.directions, args.lateral, args.increments * args.step
    )
    threads = common.threads_of(args)
    packing = common.read_packing(args.packing)
    packings = tradeoff.family(packing, args.packings)
    show = None if args.quiet else tell
    result = tradeoff.study(packings, path, args.quick, threads, show)
    result["critical"] = tradeoff.critical(
        packing, args.quick, args.critical_packings, args.void_ratio, threads
    )
    write(args.output, result)
    rows = [
        (name, f"{row['dem_steps']:.0f}", f"{row['rms_stress_error']:.2%}",
         f"{row['speedup_against_reference']:.1f}")
        for name, row in result["presets"].items()
    ]  # fmt: skip
    names = ("preset", "DEM steps per increment", "rms error of stress", "times faster")
    terminal.print_columns(f"trade-off: {args.output / 'tradeoff'}.*", names, rows, args.quiet)
    show_critical(result["critical"], args.quiet)
    if not args.quiet:
        print(*result["sentences"], sep="\n")
    return 0


def tell(row: dict[str, object]) -> None:
    """A row, as soon as it is there."""
    print(
        f"{row['setting']:22} {row['value']:>24} {row['dem_steps']:8.0f} steps"
        f"  {row['rms_stress_error']:7.2%} ± {row['spread_over_packings']:.2%}"
        f"  peak {row['peak_error']:+.2%}",
        flush=True,
    )


def show_critical(critical: dict[str, object], quiet: bool = False) -> None:
    """The table of `tradeoff.critical`."""
    rows = [
        (row["accuracy"], f"{row['dem_steps']:.0f}",
         f"{1e-3 * row['pressure_Pa']:.1f} ± {1e-3 * row['pressure_standard_error_Pa']:.1f}",
         f"{row['pressure_error']:+.0%} ± {row['pressure_error_standard_error']:.0%}",
         f"{row['friction_angle_deg']:.1f} ± {row['friction_angle_standard_error_deg']:.1f}")
        for row in critical["rows"]
    ]  # fmt: skip
    names = (
        "preset", "DEM steps per increment", "pressure, kPa", "off reference",
        "friction angle, degrees",
    )  # fmt: skip
    title = (
        f"simple shear at constant volume, e = {critical['void_ratio']:.3f}, gamma"
        f" {critical['first']:g} to {critical['last']:g}, {critical['packings']} packings"
    )
    terminal.print_columns(title, names, rows, quiet)


def write(folder: Path, result: dict[str, object]) -> None:
    """Table, picture and summary of `tradeoff.study`."""
    writing.write_csv(folder / "tradeoff.csv", COLUMNS, result["sweep"])
    lab_plots.save_tradeoff(folder / "tradeoff.png", result["sweep"], result["scatter"])
    writing.write_csv(folder / "critical.csv", CRITICAL_COLUMNS, result["critical"]["rows"])
    writing.write_json(folder / "tradeoff.json", result)
