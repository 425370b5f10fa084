"""Strength, dilatancy and critical void ratio of a packing for several contact frictions.

Dense packings (compacted without friction) of several seeds are compressed at constant lateral
pressure. Prints a table, what the papers report beside it, and one JSON object as its last line.
"""

import argparse
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from femxdem_fenicsx import terminal  # noqa: E402
from femxdem_fenicsx.dem.contacts import LinearContact  # noqa: E402
from femxdem_fenicsx.dem.element_tests import drained_compression  # noqa: E402
from femxdem_fenicsx.dem.preparation import random_packing  # noqa: E402
from femxdem_fenicsx.laboratory import finish, specimen  # noqa: E402

FRICTIONS = (0.0, 0.1, 0.3, 0.5, 1.0)
#: Guo-Zhao table I, 3.3.1, 4.2.1: mu = tan(0.5 rad), dense at e = 0.177, largest dilation 4.5 %
#: at the critical state, hence e = 1.177 * 1.045 - 1. Desrues section 2.4.2 works with mu = 0.5
#: and tells no angles.
REPORTED = {0.5: {"critical_void_ratio": 0.230, "source": "Guo-Zhao section 4.2.1, mu = 0.546"}}
MEASURES = (
    ("void_ratio", "void ratio", 3),
    ("peak_friction_angle", "peak angle (°)", 1),
    ("critical_friction_angle", "critical angle (°)", 1),
    ("dilatancy_angle", "dilatancy (°)", 1),
    ("critical_void_ratio", "critical void ratio", 3),
)


def one(friction: float, seed: int, grains: int, strain: float, dim: int) -> dict:
    """A row: one packing, one test."""
    law = LinearContact(modulus=6e8, stiffness_ratio=0.8, friction=friction)
    packing = random_packing(grains, law=law, seed=seed, dim=dim)
    made = specimen(packing)
    test = drained_compression(made.servo, 1e5, strain, 2e-3, fine=10)
    early = finish(made, test)
    told = made.strength
    return {"void_ratio": packing.void_ratio, "ended_early": early is not None} | {
        name: getattr(told, name) for name, _, _ in MEASURES[1:]
    }


def row(friction: float, tests: list[dict]) -> dict:
    """Means and standard errors over the seeds."""
    found = {"friction": friction, "tests": len(tests)}
    found["ended_early"] = sum(test["ended_early"] for test in tests)
    for name, _, _ in MEASURES:
        values = np.array([test[name] for test in tests if test[name] is not None], float)
        found[name] = float(values.mean()) if len(values) else None
        error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0.0
        found[f"{name}_error"] = float(error)
    if friction in REPORTED:
        found["reported"] = REPORTED[friction]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="100 grains, 2 seeds, 10 %% strain")
    parser.add_argument("--grains", type=int, default=400)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--strain", type=float, default=0.3)
    parser.add_argument("--dim", type=int, default=2, choices=(2, 3))
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    if args.quick:
        args.grains, args.seeds, args.strain = 100, 2, 0.1
    started = perf_counter()
    with ThreadPoolExecutor(args.threads) as pool:
        tests = {
            mu: [
                pool.submit(one, mu, seed, args.grains, args.strain, args.dim)
                for seed in range(1, args.seeds + 1)
            ]
            for mu in FRICTIONS
        }
        rows = [row(mu, [test.result() for test in some]) for mu, some in tests.items()]
    cells = []
    for found in rows:
        line = [f"{found['friction']:g}"]
        for name, _, digits in MEASURES:
            value = found[name]
            error = found[f"{name}_error"]
            line.append("–" if value is None else f"{value:.{digits}f}±{error:.{digits}f}")
        reported = found.get("reported")
        line.append(f"{reported['critical_void_ratio']:.3f}" if reported else "–")
        cells.append(line)
    names = ("mu", *(label for _, label, _ in MEASURES), "papers: critical e")
    terminal.print_columns("Mean ± standard error", names, cells)
    print(
        json.dumps({
            "grains": args.grains, "dim": args.dim, "strain": args.strain, "rows": rows,
            "seconds": perf_counter() - started,
        })
    )  # fmt: skip


if __name__ == "__main__":
    main()
