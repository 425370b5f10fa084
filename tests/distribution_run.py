"""A run for test_distribution.py: ``python -m tests.distribution_run TASK ...``."""

import json
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.files import load_packing
from femxdem_fenicsx.distribution import DistributedLaw
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from femxdem_fenicsx.law import NeoHookean

COMM = MPI.COMM_WORLD
POINTS, STEPS = 7, 4


def increments(step: int, numbers: np.ndarray) -> np.ndarray:
    """F of the points with these numbers, sheared the more the higher the number."""
    F = np.tile(np.eye(2), (len(numbers), 1, 1))
    noise = [np.random.default_rng((step, n)).uniform(-1, 1, (2, 2)) for n in numbers]
    scale = 2e-4 * (1 + np.asarray(numbers))[:, None, None]
    return F + scale * np.array(noise).reshape(F.shape)


def own_points(count: int = POINTS) -> np.ndarray:
    """This rank's points, out of order and unevenly shared: rank 0 has most."""
    owner = np.minimum(np.arange(count) ** 2 // count, COMM.size - 1)
    return np.flatnonzero(owner == COMM.size - 1 - COMM.rank)[::-1]


def everywhere(numbers: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Rows of all ranks in the order of their numbers, on rank 0."""
    parts = COMM.gather((numbers, values))
    if parts is None:
        return None
    order = np.argsort(np.concatenate([n for n, _ in parts]))
    return np.concatenate([v for _, v in parts])[order]


def grains(folder: Path, packing: str, threads: str, wander: str) -> dict:
    """Walk a packing at every point through the same F; states and answers into states.npz."""

    def make(numbers):
        packing_ = load_packing(packing)
        return HomogenisedLaw(packing_, len(numbers), PRESETS["fast"], threads=int(threads))

    points = own_points()
    law = DistributedLaw(COMM, points, make)
    balances, answers = [], []
    for step in range(STEPS):
        law.evaluate(increments(step + 100, points))
        law.discard()
        F = increments(step, points)
        answers += [everywhere(points, law.evaluate(F)), everywhere(points, law.tangent())]
        law.commit()
        balances.append(list(law.balance))
        if wander == "wander":
            law.move(np.random.default_rng(step).integers(0, COMM.size, POINTS))
    for field in law.FIELDS:
        answers.append(everywhere(points, getattr(law, field)))
    state = {name: everywhere(law.numbers, rows) for name, rows in law.law.state().items()}
    asked = int(np.flatnonzero(points == POINTS - 1)[0]) if POINTS - 1 in points else None
    positions = law.packing(asked).positions
    if COMM.rank == 0:
        named = {f"answer_{k}": answer for k, answer in enumerate(answers)}
        state = {name.replace("/", "_"): rows for name, rows in state.items()}
        np.savez(folder / "states.npz", **state, **named, positions=positions)
    return {"balances": balances, "sent": COMM.reduce(law.sent["evaluation"])}


def plane_strain(folder: Path) -> dict:
    """Spheres in plane strain on a mesh, through two load steps: what the specimen shows."""
    from femxdem_fenicsx.fem.stepping import LoadStepping, walk
    from femxdem_fenicsx.plane_strain import PlaneStrain
    from tests.fem.specimen import Specimen

    def make(numbers):
        return HomogenisedLaw(load_packing(folder / "spheres.h5", 3), len(numbers), PRESETS["fast"])

    specimen = Specimen(
        lambda points: PlaneStrain(DistributedLaw(COMM, points.index, make)),
        name="Q4", cells=(1, 2), distortion=0.0, tolerance=1e-2,
    )  # fmt: skip
    specimen.pressure.value = 1e5
    shown = []

    def observe(record):
        law, points = specimen.law, specimen.points
        stress = np.column_stack([law.stress.reshape(-1, 4), law.out_of_plane_stress])
        everyone = everywhere(points.index, stress)
        shown.append([specimen.top_force(), *([] if everyone is None else everyone.ravel())])

    outcome = walk(specimen.problem, specimen.compress, 4e-3, LoadStepping(2e-3), observe)
    return {"shown": shown, "evaluations": outcome.evaluations}


class Uneven(NeoHookean):
    """Counts steps: a point's cost is 1, and 30 where its number is small."""

    def __init__(self, numbers):
        super().__init__(len(numbers), 100.0, 0.3)
        self._state["number"] = np.asarray(numbers)

    def evaluate(self, F):
        stress = super().evaluate(F)
        self._trial |= {"number": self._state["number"]}
        return stress

    def expected_cost(self, F):
        return np.where(self._state["number"] < 4, 30_000, 1_000)


def uneven() -> dict:
    """Costs that differ 30 times: the imbalance before and after, and that nothing is lost."""
    points = np.arange(COMM.rank * 20, COMM.rank * 20 + 20)
    law = DistributedLaw(COMM, points, Uneven)
    found = []
    for step in range(3):
        law.evaluate(increments(step, points))
        law.commit()
        found.append(list(law.balance))
    return {"found": found, "sizes": COMM.allgather(law.law.size), "numbers": law.law.size}


def failing(kind: str) -> dict:
    """A law that fails at home on the last rank, for a point of the first."""
    from femxdem_fenicsx.law import InadmissibleDeformation

    class Failing(NeoHookean):
        def evaluate(self, F):
            if COMM.rank == COMM.size - 1:
                raise {"astray": InadmissibleDeformation, "broken": OSError}[kind]("grains gone")
            return super().evaluate(F)

    law = DistributedLaw(
        COMM, np.arange(COMM.rank * 3, COMM.rank * 3 + 3), lambda n: Failing(len(n), 100.0, 0.3)
    )
    try:
        law.evaluate(np.tile(np.eye(2), (3, 1, 1)))
    except Exception as error:
        return {"errors": COMM.allgather(f"{type(error).__name__}: {error}")}
    return {}


if __name__ == "__main__":
    task, *rest = sys.argv[1:]
    if task == "grains":
        result = grains(Path(rest[0]), *rest[1:])
    elif task == "plane_strain":
        result = plane_strain(Path(rest[0]))
    else:
        result = uneven() if task == "uneven" else failing(rest[0])
    if COMM.rank == 0:
        print(json.dumps(result))
