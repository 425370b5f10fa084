"""Speed for accuracy: what each setting of the micro scale costs, and how wrong it then is.

Packings are compressed along the same strain paths with one setting changed at a time, and compared
with a run far slower than needed. Steps of the DEM are the cost: they do not depend on the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from . import critical_state
from .dem.accuracy import PRESETS, Accuracy
from .dem.contacts import ContactLaw, LinearContact, RollingResistance
from .dem.element_tests import drained_compression
from .dem.grain_sizes import GivenRadii
from .dem.loading import pressure_of
from .dem.packing import Packing
from .dem.preparation import library, random_packing, settle
from .homogenised_law import HomogenisedLaw

#: Far slower than any use: I and tolerance of the run that all others are compared with.
SLOWEST = Accuracy(inertial_number=1e-5, tolerance=1e-5, hold_limit=200_000)
#: The preset that single settings are changed in.
BASE = "balanced"
#: On the lateral stress of the drained test, over the pressure.
DRAINED_TOLERANCE = 3e-3

#: Packings that the critical state is a mean of: it fluctuates by a fifth from one to the next.
CRITICAL_PACKINGS = 32
#: Shear strains between which it is read; with few values it is not quite reached.
CRITICAL_SHEAR, QUICK_SHEAR = (0.3, 0.8), (0.15, 0.25)

Change = Callable[[Packing], Packing]


class FromRest(HomogenisedLaw):
    """Every increment starts from grains at rest (Desrues section 2.4), not as they last flowed."""

    def commit(self) -> None:
        """The trial becomes the state, but for how the grains moved."""
        super().commit()
        self.response.committed.flow[:] = 0.0


@dataclass(frozen=True)
class Path:
    """Compression in several directions, in equal increments; every other one rotates too.

    Attributes:
        increments: number of them. step: axial strain of one. directions: of compression.
        lateral: extension over the axial compression.
        drained: axial strain of the drained test that is made as well.
    """

    increments: int = 20
    step: float = 1e-3
    directions: int = 4
    lateral: float = 0.8
    drained: float = 0.02

    def __post_init__(self):
        if self.increments < 1 or self.directions < 1 or not 0 < self.step < 0.1:
            raise ValueError(
                f"strain path: need 1 or more increments and directions and a step in ]0, 0.1[, got"
                f" {self.increments}, {self.directions} and {self.step}"
            )
        if not abs(self.lateral) * self.step < 0.1:
            raise ValueError(
                f"strain path: a lateral extension of {self.lateral} times {self.step} in one"
                " increment; need less than 0.1"
            )

    def F(self, dim: int) -> np.ndarray:
        """Of one increment, (directions, d, d), in the plane of the first and the last axis."""
        strain = np.diag([self.lateral / (dim - 1)] * (dim - 1) + [-1.0])
        result = []
        for k in range(self.directions):
            angle = k * np.pi / self.directions
            turn, spin = np.eye(dim), np.zeros((dim, dim))
            turn[0, 0] = turn[-1, -1] = np.cos(angle)
            turn[-1, 0], turn[0, -1] = np.sin(angle), -np.sin(angle)
            spin[-1, 0], spin[0, -1] = 0.5 * (k % 2), -0.5 * (k % 2)
            result.append(np.eye(dim) + self.step * (turn @ strain @ turn.T + spin))
        return np.array(result)


@dataclass(frozen=True)
class Case:
    """One setting at one value.

    Attributes:
        setting: its name. value: in words or digits.
        accuracy: to run with. change: to make another packing first. law: to run.
        other_grains: whether packings of the same seeds are not the same grains any more.
    """

    setting: str
    value: str
    accuracy: Accuracy
    change: Change | None = None
    law: type[HomogenisedLaw] = HomogenisedLaw
    other_grains: bool = False


@dataclass(frozen=True)
class Answer:
    """What packings answered: stress (packings, increments, directions, d, d), Pa, and the cost.

    drained: (states, 3) axial strain, stress ratio, void ratio of the first packing's drained test.
    steps: of the DEM per increment and packing. seconds: of CPU time for it.
    """

    stress: np.ndarray
    drained: np.ndarray
    steps: float
    seconds: float


def run(
    packings: Sequence[Packing],
    path: Path,
    accuracy: Accuracy,
    law: type[HomogenisedLaw] = HomogenisedLaw,
    threads: int = 1,
) -> Answer:
    """The packings along the path."""
    stresses, steps, started = [], 0, process_time()
    for packing in packings:
        packed = law(packing, path.directions, accuracy, threads=threads)
        F, answers = path.F(packing.dim), []
        for _ in range(path.increments):
            answers.append(packed.evaluate(F))
            packed.commit()
        stresses.append(answers)
        steps += packed.tally.steps
    seconds = process_time() - started
    increments = len(packings) * path.increments * path.directions
    drained = _drained(packings[0], path, accuracy, law)
    return Answer(np.array(stresses), drained, steps / increments, seconds / increments)


def _drained(packing: Packing, path: Path, accuracy: Accuracy, law) -> np.ndarray:
    one = law(packing, 1, accuracy)
    confining = float(pressure_of(one.stress[0]))
    test = drained_compression(one, confining, path.drained, path.step, tolerance=DRAINED_TOLERANCE)
    return np.array([(s.axial_strain, s.stress_ratio, float(one.void_ratio[0])) for s in test])


def scale(stress: np.ndarray) -> float:
    """Mean size of the principal stresses, Pa."""
    return float(np.abs(np.linalg.eigvalsh(0.5 * (stress + np.swapaxes(stress, -1, -2)))).mean())


def scatter(reference: Answer) -> float:
    """Standard deviation of the stress between packings, over the mean principal stress."""
    count = len(reference.stress)
    if count < 2:
        return 0.0
    apart = reference.stress - reference.stress.mean(0)
    return float(np.sqrt((apart**2).mean() * count / (count - 1))) / scale(reference.stress)


def figures(case: Case, answer: Answer, reference: Answer) -> dict[str, object]:
    """A row of the result: errors against the reference, over its mean principal stress.

    Of other grains: against the mean of the reference's packings.
    """
    expected = reference.stress.mean(0) if case.other_grains else reference.stress
    squared = ((answer.stress - expected) ** 2).mean((1, 2, 3, 4))
    by_packing = np.sqrt(squared) / scale(reference.stress)
    ours, theirs = answer.drained, reference.drained
    rows = min(len(ours), len(theirs))
    difference = ours[:rows, 1] - theirs[:rows, 1]
    return {
        "setting": case.setting,
        "same_model": case.change is None and case.setting != "contacts",
        "value": case.value,
        "rms_stress_error": float(np.sqrt(squared.mean()) / scale(reference.stress)),
        "spread_over_packings": float(by_packing.std(ddof=1)) if len(by_packing) > 1 else 0.0,
        "void_ratio_error": float(np.abs(ours[:rows, 2] - theirs[:rows, 2]).max()),
        "peak_error": float(ours[:, 1].max() / theirs[:, 1].max() - 1.0),
        "last_error": float(difference[-1] / theirs[rows - 1, 1]),
        "curve_error": float(np.sqrt((difference**2).mean()) / theirs[:, 1].mean()),
        "dem_steps": answer.steps,
        "seconds": answer.seconds,
    }


def settings(quick: bool) -> Iterator[Case]:
    """Presets, then one setting of `BASE` at a time, from the slowest value to the fastest."""
    base = PRESETS[BASE]
    for name, accuracy in PRESETS.items():
        yield Case("preset", name, accuracy)

    def values(every: Sequence[float], few: Sequence[float]) -> Sequence[float]:
        return few if quick else every

    numbers = values((1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1), (1e-4, 1e-3, 1e-2, 1e-1))
    for number in numbers:
        yield Case("inertial number", f"{number:g}", base.but(inertial_number=number))
    limit = SLOWEST.hold_limit
    for tolerance in values((1e-4, 1e-3, 1e-2, 1e-1), (1e-3, 1e-2, 1e-1)):
        accuracy = base.but(tolerance=tolerance, hold_limit=limit)
        yield Case("equilibrium tolerance", f"{tolerance:g}", accuracy)
    for share in values((0.2, 0.5, 0.95, 1.0), (0.3, 0.95)):
        yield Case("time step", f"{share:g}", base.but(time_step=share))
    for damping in values((0.1, 0.3, 0.5, 0.7), (0.1, 0.3, 0.7)):
        yield Case("damping while loading", f"{damping:g}", base.but(damping=damping))
    for damping in values((0.2, 0.5, 0.8), (0.5, 0.8)):
        yield Case("damping while held", f"{damping:g}", base.but(hold_damping=damping))
    yield Case("start of an increment", "rest", base, law=FromRest)
    yield Case("start of an increment", "flow", base)


def physics(packings: Sequence[Packing], quick: bool) -> Iterator[Case]:
    """What changes the model too: stiffness level, number of grains, what contacts know."""
    base, first = PRESETS[BASE], packings[0]
    pressure = float(pressure_of(HomogenisedLaw(first, 1).stress[0]))
    linear = isinstance(first.law, LinearContact) and first.law.modulus is not None
    own = first.stiffness_level(pressure)

    def stiffer(times: float) -> Change:
        law = replace(first.law, modulus=times * first.law.modulus)
        return lambda packing: settle(packing.but(law=law), pressure)

    if linear:
        for times in (10.0, 1.0, 0.1) if quick else (10.0, 3.0, 1.0, 0.3, 0.1):
            yield Case("stiffness level", f"{times * own:.3g}", base, stiffer(times))
    if first.dim == 2:
        for grains in (400, 100) if quick else (400, 225, 100):
            yield Case(
                "grains per packing", f"{grains}", base, _regrained(first, grains, pressure),
                other_grains=True,
            )  # fmt: skip
    yield Case("contacts", "as given", base)
    for name, law in switched(first.law).items():
        yield Case("contacts", name, base, lambda packing, law=law: packing.but(law=law))


def switched(law: ContactLaw) -> dict[str, ContactLaw]:
    """The contact law with one feature switched on or off, by what is different."""
    result = {}
    if law.friction:
        result["without friction"] = replace(law, friction=0.0, rolling=None, bonds=None)
    else:
        result["with friction"] = replace(law, friction=0.5)
    if law.cohesion:
        result["without cohesion"] = replace(law, cohesion=0.0)
    if law.viscous_damping:
        result["without viscous damping"] = replace(law, viscous_damping=0.0)
    if law.bonds is not None:
        result["without bonds"] = replace(law, bonds=None)
    if law.rolling is not None:
        result["without rolling resistance"] = replace(law, rolling=None)
    elif law.friction:
        result["with rolling resistance"] = replace(law, rolling=RollingResistance(0.1))
    return result


def _regrained(like: Packing, grains: int, pressure: float) -> Change:
    """Packings of another number of the same kind of grains, one seed after the other."""
    rng, seeds = np.random.default_rng(0), iter(range(1, 1000))
    radii = np.quantile(like.radii, (np.arange(grains) + 0.5) / grains)
    sizes = GivenRadii(tuple(rng.permutation(radii)))

    def prepare(packing: Packing) -> Packing:
        return random_packing(
            grains, sizes, packing.law, pressure, seed=next(seeds), density=packing.density,
            thickness=packing.thickness,
        )  # fmt: skip

    return prepare


def family(packing: Packing, count: int) -> list[Packing]:
    """The packing and others of the same grains, prepared densely under the same pressure."""
    pressure = float(pressure_of(HomogenisedLaw(packing, 1).stress[0]))
    if not pressure > 0:
        raise ValueError("the packing bears no pressure: prepare it under one first")
    if count == 1:
        return [packing]
    others = library(
        count - 1, radii=GivenRadii(tuple(packing.radii)), grains=packing.size, law=packing.law,
        pressure=pressure, density=packing.density, dim=packing.dim,
        thickness=packing.thickness if packing.dim == 2 else None,
    )  # fmt: skip
    return [packing, *others]


def study(
    packings: Sequence[Packing],
    path: Path,
    quick: bool = False,
    threads: int = 1,
    show: Callable[[dict[str, object]], None] | None = None,
) -> dict[str, object]:
    """The whole trade-off of the micro scale.

    Args:
        packings: that errors are averaged over, and whose scatter they are compared with (see
            `family`). path: that they are led along.
        quick: fewer values.
        threads: for the reference run; the others take one, so that their time can be compared.
        show: called with each row, if given.

    Returns `presets`, `sweep` (rows of `figures`), `scatter`, `sentences` and `reference`.
    """
    reference = run(packings, path, SLOWEST, threads=threads)
    short = replace(path, increments=1, drained=path.step)
    sweep = []
    for case in (*settings(quick), *physics(packings, quick)):
        changed = packings if case.change is None else [case.change(p) for p in packings]
        run(changed[:1], short, PRESETS["fast"])  # compiles, which is not to be timed
        sweep.append(figures(case, run(changed, path, case.accuracy, case.law), reference))
        if show is not None:
            show(sweep[-1])
    presets = {row["value"]: row for row in sweep if row["setting"] == "preset"}
    slow = presets["reference"]["dem_steps"]
    apart = scatter(reference)
    return {
        "presets": {
            name: row | {"speedup_against_reference": slow / row["dem_steps"]}
            for name, row in presets.items()
        },
        "sweep": sweep,
        "scatter": apart,
        "packings": len(packings),
        "reference": {
            "inertial_number": SLOWEST.inertial_number, "tolerance": SLOWEST.tolerance,
            "dem_steps": reference.steps,
        },
        "sentences": sentences(sweep, apart),
    }  # fmt: skip


def critical(
    packing: Packing,
    quick: bool = False,
    packings: int | None = None,
    void_ratio: float | None = None,
    threads: int = 1,
) -> dict[str, object]:
    """The presets at the critical state, in simple shear at constant volume.

    Args:
        packing: whose grains are taken. quick: for less shear.
        packings: 2 or more, of which the mean is; by default `CRITICAL_PACKINGS`, 2 if quick.
        void_ratio: that is kept; by default the critical one under the packing's own pressure.
        threads: for all runs.

    Returns `void_ratio`, `first` and `last` shear strain, `packings` and `rows`, see
    `critical_state.row`.
    """
    first, last = QUICK_SHEAR if quick else CRITICAL_SHEAR
    shear = critical_state.Shear(first=first, last=last)
    if void_ratio is None:
        void_ratio = critical_state.critical_void_ratio(packing, shear)
    shear = replace(shear, void_ratio=void_ratio)
    count = packings or (2 if quick else CRITICAL_PACKINGS)
    rows = critical_state.presets(family(packing, count), shear, threads)
    return {
        "void_ratio": shear.void_ratio, "first": first, "last": last, "packings": count,
        "rows": rows,
    }  # fmt: skip


def sentences(
    sweep: Sequence[dict], apart: float, error_name: str = "rms_stress_error"
) -> list[str]:
    """One for each setting: from its most costly value to the fastest."""
    told = []
    for setting in dict.fromkeys(row["setting"] for row in sweep):
        rows = [row for row in sweep if row["setting"] == setting]
        if len(rows) == 1:
            continue
        # another model costs more or less per step too, and its drained test tells it best
        cost, name = "dem_steps", error_name
        if not all(row["same_model"] for row in rows):
            cost, name = "seconds", "curve_error"
        slow, fast = (f(rows, key=lambda row, cost=cost: row[cost]) for f in (max, min))
        times, error = slow[cost] / fast[cost], fast[name]
        beside = "less" if error < apart else "more"
        told.append(
            f"{setting} from {slow['value']} to {fast['value']}: {times:.2g} times faster,"
            f" {error:.1%} error ({slow[name]:.1%} before), {beside} than the"
            f" scatter between packings ({apart:.1%})"
        )
    return told
