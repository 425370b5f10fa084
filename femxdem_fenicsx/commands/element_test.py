"""`femxdem element-test`: the tests of a soil laboratory on one packing."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import lab_plots, laboratory, terminal, writing
from ..dem import element_tests as tests
from ..dem import probes
from ..dem.accuracy import preset, warn_of_rate
from ..dem.files import save_packing
from ..dem.load_path import read_path
from ..dem.mixed_control import ElementState
from ..dem.packing import Packing
from ..dem.preparation import check_stiffness
from ..dem.probes import Envelope
from ..dem.tangents import operator
from ..homogenised_law import HomogenisedLaw
from ..reached import Reached
from . import common

#: Increments that the first step of a compression is cut into, to see the stiffness.
FINE = 5
#: Increment of axial strain of spheres: they unload over 6e-4, and two sides are to be found.
SPHERE_STEP = 5e-4


@dataclass(frozen=True)
class Test:
    """One test of the list.

    help: in a line. dim: of the packing, None for both. options: puts its own into a parser. begin:
    the states, from (specimen, arguments). load: how far it is, 1 at the end. picture: draws
    the rows. tells: what the summary says of it, see `summary`.
    """

    help: str
    dim: int | None
    options: Callable[[argparse.ArgumentParser], None]
    begin: Callable[[laboratory.Specimen, argparse.Namespace], Iterator[ElementState]]
    load: Callable[[laboratory.Specimen, argparse.Namespace], float]
    picture: Callable[[Path, list], None]
    tells: tuple[str, ...]


def _strain(default: float, what: str = "axial strain", step: float = 1e-3) -> Callable:
    def options(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--strain", type=float, default=default, help=f"{what} to reach")
        parser.add_argument("--step", type=float, default=step, help="of it per increment")

    return options


def _axial(made: laboratory.Specimen, args: argparse.Namespace) -> float:
    return made.rows[-1]["strain_yy" if made.packing.dim == 2 else "strain_zz"] / args.strain


def _drained(specimen, args):
    lateral = -np.diagonal(specimen.servo.stress)[:-1].mean()
    pressure = lateral if args.pressure is None else args.pressure
    return tests.drained_compression(
        specimen.servo, pressure, args.strain, args.step, args.free_shear, fine=FINE
    )


def _drained_options(step: float) -> Callable:
    def options(parser: argparse.ArgumentParser) -> None:
        _strain(0.1, step=step)(parser)
        parser.add_argument(
            "--free-shear", action="store_true", help="let the box shear, without shear stress"
        )

    return options


def _isotropic_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--to", type=float, default=1e6, help="mean pressure to reach, Pa")
    parser.add_argument("--increments", type=int, default=30, help="to there")
    parser.add_argument("--unload", action="store_true", help="and back again")


def _isotropic(specimen, args):
    if not args.to > 0 or args.increments < 1:
        raise ValueError("--to must be a positive pressure and --increments 1 or more")
    check_stiffness(specimen.packing, args.to)
    first = specimen.servo.pressure
    yield from tests.isotropic_compression(specimen.servo, args.to, args.increments)
    if args.unload:
        yield from tests.isotropic_compression(specimen.servo, first, args.increments)


def _oedometric_options(parser: argparse.ArgumentParser) -> None:
    _strain(0.01)(parser)
    parser.add_argument("--unload", type=float, help="axial strain to take back again")


def _oedometric(specimen, args):
    yield from tests.oedometric_compression(specimen.servo, args.strain, args.step, FINE)
    if args.unload:
        back = args.unload / (1 - args.strain)
        yield from tests.oedometric_compression(specimen.servo, -back, args.step)


def _shear_options(parser: argparse.ArgumentParser) -> None:
    _strain(0.2, "shear strain gamma")(parser)
    _normal_option(parser)


def _normal_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--normal-stress", type=float,
        help="vertical stress to keep, Pa  (default: constant volume)",
    )  # fmt: skip


def _cyclic_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cycles", type=int, default=15, help="at most")
    parser.add_argument("--amplitude", type=float, help="shear strain gamma that it turns at")
    parser.add_argument("--shear-stress", type=float, help="Pa that it turns at instead")
    parser.add_argument("--step", type=float, default=5e-4, help="of gamma per increment")
    parser.add_argument(
        "--largest", type=float, default=0.1, help="gamma that ends a stress-controlled test"
    )
    _normal_option(parser)


def _cyclic(specimen, args):
    if args.cycles < 1:
        raise ValueError(f"--cycles must be 1 or more, got {args.cycles}")
    amplitude = args.amplitude
    if amplitude is None and args.shear_stress is None:
        amplitude = 0.01
    return tests.cyclic_shear(
        specimen.servo, args.cycles, amplitude, args.shear_stress, args.step,
        args.normal_stress, args.largest,
    )  # fmt: skip


def _true_triaxial_options(parser: argparse.ArgumentParser) -> None:
    _strain(0.1, step=SPHERE_STEP)(parser)
    parser.add_argument("--b", type=float, default=0.5, help="(s_2 - s_3) / (s_1 - s_3)")


def _path_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--path", type=Path, required=True, help="CSV; see docs/laboratory.md")


def _path(specimen, args):
    return tests.along(specimen.servo, read_path(args.path, specimen.packing.dim))


def _increments(made: laboratory.Specimen, args: argparse.Namespace) -> float:
    if args.name == "isotropic":
        return len(made.states) / (args.increments * (2 if args.unload else 1))
    total = sum(leg.increments for leg in read_path(args.path, made.packing.dim))
    return len(made.states) / total


def _turns(made: laboratory.Specimen, args: argparse.Namespace) -> float:
    gamma = [state.shear_strain for state in made.states]
    return 0.5 * np.count_nonzero(np.diff(np.sign(np.diff(gamma)))) / args.cycles


SHEARED = (
    "peak_friction_angle", "strain_at_peak", "dilatancy_angle", "critical_friction_angle",
    "critical_void_ratio", "critical_steady",
)  # fmt: skip
DRAINED = (*SHEARED, "young_modulus_Pa", "poisson_ratio")
UNDRAINED = (
    "peak_friction_angle",
    "strain_at_peak",
    "critical_friction_angle",
    "least_pressure_Pa",
)
CYCLIC = ("peak_friction_angle", "largest_shear_strain", "least_pressure_Pa", "liquefied")

TESTS: dict[str, Test] = {
    "isotropic": Test(
        "isotropic compression", None, _isotropic_options, _isotropic, _increments,
        lab_plots.save_consolidation, ("bulk_modulus_Pa",),
    ),
    "oedometric": Test(
        "axial compression without lateral strain", None, _oedometric_options, _oedometric,
        _axial, lab_plots.save_consolidation, ("oedometric_modulus_Pa", "lateral_ratio"),
    ),
    "biaxial": Test(
        "drained biaxial compression of disks", 2, _drained_options(1e-3), _drained, _axial,
        lab_plots.save_compression_test, DRAINED,
    ),
    "triaxial": Test(
        "drained triaxial compression of spheres", 3, _drained_options(SPHERE_STEP), _drained,
        _axial, lab_plots.save_compression_test, DRAINED,
    ),
    "undrained": Test(
        "axial compression at constant volume", None, _strain(0.1),
        lambda specimen, args: tests.constant_volume_compression(
            specimen.servo, args.strain, args.step, FINE
        ),
        _axial, lab_plots.save_compression_test, UNDRAINED,
    ),
    "simple-shear": Test(
        "monotonic simple shear", None, _shear_options,
        lambda specimen, args: tests.simple_shear(
            specimen.servo, args.strain, args.step, args.normal_stress, FINE
        ),
        lambda made, args: abs(made.servo.shear) / args.strain, lab_plots.save_shear_test, SHEARED,
    ),
    "cyclic-shear": Test(
        "cyclic simple shear, strain or stress controlled", None, _cyclic_options, _cyclic,
        _turns, lab_plots.save_shear_test, CYCLIC,
    ),
    "true-triaxial": Test(
        "spheres under three different stresses, mean pressure kept", 3, _true_triaxial_options,
        lambda specimen, args: tests.true_triaxial(
            specimen.servo, args.strain, args.b, args.step, FINE
        ),
        _axial, lab_plots.save_compression_test, SHEARED,
    ),
    "path": Test(
        "your own path from a CSV file", None, _path_options, _path, _increments,
        lab_plots.save_compression_test, ("peak_friction_angle",),
    ),
}  # fmt: skip


def add(commands) -> None:
    """The subcommands into a parser's."""
    parser = commands.add_parser("element-test", help="test one packing")
    below = parser.add_subparsers(metavar="NAME", required=True, parser_class=type(parser))
    for name, test in TESTS.items():
        command = below.add_parser(name, help=test.help, description=test.help)
        test.options(command)
        _add_shared(command, name)
        command.set_defaults(run=run, name=name)
    command = below.add_parser(
        "probes", help="response envelopes (Gudehus)", description=run_probes.__doc__
    )
    command.add_argument("--by", choices=("strain", "stress"), default="strain", help="prescribed")
    command.add_argument(
        "--size", type=float, help="of a probe  (default: strain 2e-4, or 5 %% of the pressure, Pa)"
    )
    command.add_argument("--directions", type=int, default=36)
    _add_shared(command, "probes")
    common.add_threads(command)
    command.set_defaults(run=run_probes, name="probes")


def _add_shared(parser: argparse.ArgumentParser, name: str) -> None:
    parser.add_argument("--packing", type=Path, required=True, help="HDF5 file")
    parser.add_argument(
        "--pressure", type=float,
        help="mean pressure to consolidate to before, Pa  (default: the packing's own)",
    )  # fmt: skip
    common.add_accuracy(parser)
    parser.add_argument(
        "--tolerance", type=float, default=laboratory.TOLERANCE,
        help="on prescribed stress, over the pressure",
    )  # fmt: skip
    parser.add_argument(
        "--output", type=Path, default=Path("results/element-test"),
        help=f"folder; files are called {name}.csv, .png, .json and {name}-end.h5",
    )  # fmt: skip
    common.add_quiet(parser)


def run(args: argparse.Namespace) -> int:
    """One of `TESTS`: progress, table, picture, summary; exit code 3 where it ended early."""
    test = TESTS[args.name]
    _check(args)
    packing = _packing(args, test.dim)
    if args.name == "path":
        if args.path.resolve() == (args.output / "path.csv").resolve():
            raise ValueError(
                f"{args.path}: the results would overwrite it; choose another --output"
            )
        read_path(args.path, packing.dim)  # before anything is computed
    if _at_constant_volume(args):
        warn_of_rate(preset(args.accuracy), args.name)
    made = laboratory.specimen(packing, args.pressure, preset(args.accuracy), args.tolerance)
    with terminal.LoadProgress(1.0, args.quiet, args.name) as progress:

        def show(state: ElementState) -> None:
            row = made.rows[-1]
            progress.show(
                min(max(test.load(made, args), 1e-9), 1.0),
                f"{len(made.states)}: phi {row['friction_angle_deg']:.1f} degrees  p"
                f" {1e-3 * row['pressure_Pa']:.1f} kPa  e {row['void_ratio']:.4f}",
            )

        early = laboratory.finish(made, test.begin(made, args), show)
    if not made.states:
        raise ValueError(early or "the test has no increments")
    return _write(args, test, made, early)


def _check(args: argparse.Namespace) -> None:
    """What would otherwise go wrong after a while."""
    strain, step = getattr(args, "strain", None), getattr(args, "step", None)
    if strain is not None:
        limit = 1.0 if args.name != "simple-shear" else np.inf
        if not 0 < step <= strain < limit:
            raise ValueError(
                f"--step {step} and --strain {strain}: need 0 < step <= strain"
                + (" < 1" if limit == 1 else "")
            )
    elif step is not None and not step > 0:
        raise ValueError(f"--step must be positive, got {step}")
    for name in ("amplitude", "shear_stress", "normal_stress"):
        value = getattr(args, name, None)
        if value is not None and not value > 0:
            raise ValueError(f"--{name.replace('_', '-')} must be positive, got {value}")


def _at_constant_volume(args: argparse.Namespace) -> bool:
    """Whether the pressure follows from a volume that is kept."""
    sheared = args.name in ("simple-shear", "cyclic-shear")
    return args.name == "undrained" or (sheared and args.normal_stress is None)


def _packing(args: argparse.Namespace, dim: int | None) -> Packing:
    packing = common.read_packing(args.packing)
    if dim is not None and packing.dim != dim:
        kinds = {2: "disks", 3: "spheres"}
        raise ValueError(
            f"{args.packing}: these are {kinds[packing.dim]}, the {args.name} test needs"
            f" {kinds[dim]}"
        )
    return packing


def _write(args, test: Test, made: laboratory.Specimen, early: str | None) -> int:
    """All files, then the summary; exit code 3 where the test ended early."""
    folder, name = args.output, args.name
    writing.write_csv(folder / f"{name}.csv", tuple(made.rows[0]), made.rows)
    test.picture(folder / f"{name}.png", made.rows)
    save_packing(folder / f"{name}-end.h5", made.now)
    told = {key: value for key, value in laboratory.summary(made).items() if key in test.tells}
    last, reached = made.rows[-1], Reached.by(made.law)
    ran = {
        "increments": len(made.states),
        "increments_within_looser_tolerance": made.servo.loose,
        "largest_stress_error_Pa": max(state.error for state in made.states),
        "holds_at_limit": reached.holds_at_limit,
        "worst_unbalance": reached.unbalance,
        "largest_inertial_number": reached.inertial_number,
        "largest_overlap": reached.overlap,
        "void_ratios": [made.rows[0]["void_ratio"], last["void_ratio"]],
        "mean_pressures_Pa": [made.rows[0]["pressure_Pa"], last["pressure_Pa"]],
        "ended_early": early,
    }
    writing.write_json(folder / f"{name}.json", told | ran)
    table = _lines(told, ran) | reached.table
    terminal.print_table(f"{name}: {folder / name}.*", table, args.quiet)
    if reached.warning:
        print(reached.warning)
    if early is not None:
        print(f"the test ended early: {early}")
        return terminal.LOST_CONTROLLABILITY
    return 0


def _lines(told: dict, ran: dict) -> dict[str, str]:
    """The table at the end."""
    rows = {}
    for key, value in told.items():
        name, unit = key.removesuffix("_Pa").replace("_", " "), "MPa" if key.endswith("_Pa") else ""
        if "angle" in key:
            unit = "degrees"
        if value is None:
            rows[name] = "–"
        elif isinstance(value, bool):
            rows[name] = "yes" if value else "no"
        else:
            rows[name] = f"{1e-6 * value if unit == 'MPa' else value:.4g} {unit}".rstrip()
    pressures, loose = ran["mean_pressures_Pa"], ran["increments_within_looser_tolerance"]
    return rows | {
        "void ratio, first and last": "{:.4f}, {:.4f}".format(*ran["void_ratios"]),
        "mean pressure": f"{1e-3 * pressures[0]:.1f} to {1e-3 * pressures[1]:.1f} kPa",
        "increments": f"{ran['increments']}, {loose} of them within the looser tolerance",
        "largest stress error": f"{ran['largest_stress_error_Pa']:.3g} Pa",
    }


def run_probes(args: argparse.Namespace) -> int:
    """Small probes in all directions of the plane of lateral and axial strain or stress."""
    packing = _packing(args, None)
    made = laboratory.specimen(packing, args.pressure, preset(args.accuracy), args.tolerance)
    state, pressure = made.now, made.servo.pressure
    probes.directions(args.directions)  # before anything is computed
    if args.by == "strain":
        size = 2e-4 if args.size is None else args.size
        threads = common.threads_of(args)
        law = HomogenisedLaw(state, args.directions, preset(args.accuracy), threads=threads)
        found = probes.strain_probes(law, size)
    else:
        size = 0.05 * pressure if args.size is None else args.size
        found = probes.stress_probes(
            lambda: HomogenisedLaw(state, 1, preset(args.accuracy)), size, args.directions,
            1e-2 * size,
        )  # fmt: skip
    bound = upper_bound(state, found) if args.by == "strain" else None
    names = ("lateral_strain", "axial_strain", "lateral_stress_Pa", "axial_stress_Pa")
    rows = np.column_stack([found.strain, found.stress]).tolist()
    writing.write_csv(
        args.output / "probes.csv", names, [dict(zip(names, row, strict=True)) for row in rows]
    )
    lab_plots.save_envelope(args.output / "probes.png", found, bound)
    stiffness = 1e-6 * found.stiffness
    result = {"by": args.by, "size": size, "directions": args.directions} | {
        f"{name}_stiffness_MPa": float(value)
        for name, value in (("smallest", stiffness.min()), ("largest", stiffness.max()))
    }
    writing.write_json(args.output / "probes.json", result)
    table = {
        "probes": f"{args.directions} of {args.by} {size:g}" + (" Pa" * (args.by == "stress")),
        "stiffness": f"{stiffness.min():.1f} to {stiffness.max():.1f} MPa",
    }
    terminal.print_table(f"probes: {args.output / 'probes'}.*", table, args.quiet)
    return 0


def upper_bound(packing: Packing, envelope: Envelope) -> Envelope:
    """What the packing would answer if its grains followed the strain (Kruyt's upper bound)."""
    law = HomogenisedLaw(packing, 1)
    C = operator("UKO")(law.response, np.eye(packing.dim)[None])[0]
    strain = probes.tensor(envelope.strain, packing.dim)
    return Envelope(envelope.strain, probes.plane(np.einsum("ijkl,nkl->nij", C, strain)))
