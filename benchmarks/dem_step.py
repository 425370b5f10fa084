"""Time of one DEM step of one packing on one core, in the deviatoric regime, where contacts slide.

Prints one JSON object as its last line.
"""

import argparse
import json
import sys
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from femxdem_fenicsx.dem import dynamics  # noqa: E402
from femxdem_fenicsx.dem.accuracy import PRESETS  # noqa: E402
from femxdem_fenicsx.dem.contacts import LinearContact  # noqa: E402
from femxdem_fenicsx.dem.files import load_packing  # noqa: E402
from femxdem_fenicsx.dem.homogenisation import measure  # noqa: E402
from femxdem_fenicsx.dem.loading import settings  # noqa: E402
from femxdem_fenicsx.dem.packing import Packing  # noqa: E402
from femxdem_fenicsx.dem.preparation import workspace_of  # noqa: E402
from femxdem_fenicsx.dem.response import Response  # noqa: E402

#: Rates of extension along the axes, 1/s: about I = 1e-3 at 100 kPa.
EXTENSION = {2: [0.4, -0.5], 3: [0.2, -0.5, 0.2]}


def sheared(packing: Packing) -> tuple[dynamics.Workspace, float, np.ndarray]:
    """A work space with the packing at 1 % axial strain, its time step, and the L it moves with."""
    work = workspace_of(packing)
    dt = settings(packing, PRESETS["balanced"], 1e5).time_step
    gradient = np.diag(EXTENSION[packing.dim])
    advance(packing, work, round(0.01 / 0.5 / dt), dt, gradient)
    return work, dt, gradient


def advance(packing: Packing, work: dynamics.Workspace, steps: int, dt: float, gradient) -> None:
    """Take that many steps."""
    material = packing.material
    dynamics.advance(steps, dt, gradient, 0.3, material, work, material.inverse_radius)


def row(case: str, packing: Packing, repeats: int, steps: int) -> dict:
    """The fastest of some repetitions, in CPU time."""
    work, dt, gradient = sheared(packing)
    fastest = np.inf
    for _ in range(repeats):
        started = process_time()
        advance(packing, work, steps, dt, 0.1 * gradient)
        fastest = min(fastest, process_time() - started)
    stress, fabric = np.zeros((2, packing.dim, packing.dim))
    contacts, _ = measure(
        work.motion, work.pairs, packing.law.elasticity, packing.material.cohesion, None,
        packing.thickness, stress, fabric,
    )  # fmt: skip
    return {
        "case": case,
        "us_per_step": 1e6 * fastest / steps,
        "grain_steps_per_second": packing.size * steps / fastest,
        "contacts": contacts,
        "pairs": int(work.pairs.first[-1]),
    }


def batches(packing: Packing, repeats: int) -> list[dict]:
    """64 packings under one increment each, by one thread and by two in turn; wall-clock time.

    Each row has the time per packing and step, the fastest of all repetitions.
    """
    F = np.eye(2) + np.diag([0.8e-3, -1e-3])
    F = F + 1e-4 * np.random.default_rng(0).uniform(-1, 1, (64, 2, 2))
    responses = {threads: Response(packing, 64, PRESETS["balanced"], threads) for threads in (1, 2)}
    for response in responses.values():
        for _ in range(5):
            response.deform(F)
            response.commit()
    fastest = dict.fromkeys(responses, np.inf)
    for _ in range(repeats):
        for threads, response in responses.items():
            started = perf_counter()
            outcome = response.deform(F)
            fastest[threads] = min(fastest[threads], perf_counter() - started)
    steps = int((outcome.loading_steps + outcome.hold_steps).sum())
    return [
        {
            "case": f"batch-64-threads-{threads}",
            "us_per_step": 1e6 * fastest[threads] / steps,
            "grain_steps_per_second": packing.size * steps / fastest[threads],
            "contacts": int(outcome.contacts.mean()),
            "speedup": fastest[1] / fastest[threads],
        }
        for threads in responses
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    args = parser.parse_args()
    repeats, steps = (5, 500) if args.quick else (20, 2000)
    disks = load_packing(ROOT / "tests" / "data" / "yade" / "packing.h5")
    started = perf_counter()
    sheared(disks)
    first = perf_counter() - started
    spheres = load_packing(ROOT / "tests" / "data" / "yade" / "spheres.h5", dim=3)
    smooth = LinearContact(modulus=6e8, friction=0.0)
    rows = [
        row("disks-400", disks, repeats, steps),
        row("disks-400-frictionless", disks.but(law=smooth), repeats, steps),
        row("spheres-1000", spheres, repeats, steps // 4),
        row("spheres-1000-frictionless", spheres.but(law=smooth), repeats, steps // 4),
        *batches(disks, 20 if args.quick else 100),
    ]
    for line in rows:
        print(f"{line['case']:26s} {line['us_per_step']:6.2f} us per step")
    print(json.dumps({"rows": rows, "first_start_s": first}))


if __name__ == "__main__":
    main()
