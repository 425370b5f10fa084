"""How near the three loops of a DEM step are to what one core can do.

For disks and spheres: the time of each loop, the instructions of the vectorised loop over the
pairs, read off its machine code, the bytes that pass, and beside them what this core reaches in
multiplying and adding, in dividing, in gathering and in copying. One JSON object as its last line.
"""

import argparse
import inspect
import json
import re
import sys
from collections import Counter
from pathlib import Path
from time import process_time

import numpy as np
from numba import njit

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

from dem_step import sheared  # noqa: E402

from femxdem_fenicsx.dem import disks, dynamics, spheres  # noqa: E402
from femxdem_fenicsx.dem.files import load_packing  # noqa: E402

compiled = njit(nogil=True, error_model="numpy")  # as kernels are, but not from a cache
LOOPS = ("pair_forces", "sum_forces", "move")

#: Operations of a packed instruction per lane, by the beginning of its name.
FLOPS = {"vfm": 2, "vfnm": 2, "vadd": 1, "vsub": 1, "vmul": 1, "vdiv": 1}
FLOPS |= {"vsqrt": 1, "vmax": 1, "vmin": 1}


def fastest(call, repeats: int) -> float:
    """Seconds of the fastest of some calls."""
    times = []
    for _ in range(repeats):
        started = process_time()
        call()
        times.append(process_time() - started)
    return min(times)


# ---- the loops -----------------------------------------------------------------------------------


def arguments_of(work, material, dt: float, gradient: np.ndarray) -> dict[str, tuple]:
    """What `dynamics.advance` passes to each loop, found by letting it call ones that listen."""
    module = disks if material.inverse_radius is None else spheres
    heard = {}
    originals = {name: getattr(module, name) for name in LOOPS}
    try:
        for name in LOOPS:
            setattr(module, name, lambda *given, name=name: heard.setdefault(name, given))
        dynamics.advance.py_func(1, dt, gradient, 0.3, material, work, material.inverse_radius)
    finally:
        for name, original in originals.items():
            setattr(module, name, original)
    return heard


def repeated(function):
    """A compiled loop over calls of a kernel, which keeps the cost of calling out of the time."""
    names = ", ".join(inspect.signature(function.py_func).parameters)
    source = f"def run(times, {names}):\n    for _ in range(times):\n        function({names})\n"
    scope = {"function": function}
    exec(source, scope)
    return compiled(scope["run"])


def vector_loop(function, given: tuple) -> dict:
    """Instructions per pair of the hottest loop, and lanes, read off the machine code."""
    fresh = compiled(function.py_func)
    fresh(*given)
    code = fresh.inspect_asm(fresh.signatures[0])
    blocks = re.split(r"^\.?L\w+:", code, flags=re.M)
    body = max(blocks, key=lambda block: block.count("vgather"))
    lanes = 8 if "%zmm" in body else 4
    names = Counter(
        line.split()[0] for line in body.splitlines() if line.startswith("\t") and "\t." not in line
    )
    packed = {name: count for name, count in names.items() if name.endswith("pd")}

    def of(*starts: str) -> int:
        return sum(count for name, count in packed.items() if name.startswith(starts))

    def flops(name: str) -> int:
        return next((n for start, n in FLOPS.items() if name.startswith(start)), 0)

    return {
        "lanes": lanes,
        "flops_per_pair": sum(flops(name) * count for name, count in packed.items()),
        "divisions_and_roots_per_pair": of("vdiv", "vsqrt"),
        "gathers_per_pair": of("vgather"),
        "instructions_per_pair": sum(names.values()) / lanes,
    }


def bytes_per_pair(dim: int, friction: bool) -> int:
    """Read and written in the pair loop, a gathered value counted once for each of its uses."""
    spins = 1 if dim == 2 else 3
    streams = 8 + 8 * (dim + 2)  # grains; shift, reach, coefficient
    gathered = 2 * 8 * dim * (2 if friction else 1)
    written = 8 * dim
    if friction:
        gathered += 2 * 8 * spins + (2 * 8 if dim == 3 else 0)  # spins; inverse radii
        streams += 8 * spins + (24 if dim == 3 else 0)  # tangential forces; normals
        written += 16 * spins + (24 if dim == 3 else 0)  # the same again, and moments
    return streams + gathered + written


# ---- the core ------------------------------------------------------------------------------------


@compiled
def multiply_and_add(times, x, a, b):
    for _ in range(times):
        for k in range(x.size):
            y = x[k]
            for _ in range(8):
                y = y * a + b
            x[k] = y


@compiled
def divide(times, x):
    for _ in range(times):
        for k in range(x.size):
            x[k] = 1.0 / (x[k] + 1.0)


@compiled
def gather(times, x, index):
    total = 0.0
    for _ in range(times):
        for k in range(index.size):
            total += x[index[k]]
    return total


@compiled
def copy(times, a, b):
    for _ in range(times):
        for k in range(a.size):
            b[k] = a[k] + 1.0
        for k in range(a.size):
            a[k] = b[k] + 1.0


def core(repeats: int) -> dict:
    """Billions per second that this core reaches, with data in its nearer caches."""
    near, far = np.ones(512), np.ones(2**15)  # 4 kB; 256 kB, beyond the first cache
    index = np.random.default_rng(0).integers(0, 512, 4096).astype(np.uint32)
    other = far.copy()
    cases = {
        "flops": (lambda: multiply_and_add(2000, near, 0.999, 1e-3), 2000 * 512 * 16),
        "divisions": (lambda: divide(2000, near), 2000 * 512),
        "gathered": (lambda: gather(500, near, index), 500 * 4096),
        "bytes": (lambda: copy(50, far, other), 50 * 2 * 16 * far.size),
    }
    result = {}
    for name, (call, count) in cases.items():
        call()
        result[name] = count / fastest(call, repeats) / 1e9
    return result


def row(case: str, path: Path, dim: int, peak: dict, repeats: int) -> dict:
    packing = load_packing(path, dim)
    work, dt, gradient = sheared(packing)
    module = disks if dim == 2 else spheres
    heard = arguments_of(work, packing.material, dt, 0.1 * gradient)
    times, micro = 200, {}
    for name in LOOPS:
        run = repeated(getattr(module, name))
        run(1, *heard[name])
        micro[name] = 1e6 * fastest(lambda run=run, n=name: run(times, *heard[n]), repeats) / times
    pairs = int(work.pairs.first[-1])
    loop = vector_loop(module.pair_forces, heard["pair_forces"])
    moved = bytes_per_pair(dim, True)
    bounds = {
        "flops": loop["flops_per_pair"] / peak["flops"],
        "divisions": loop["divisions_and_roots_per_pair"] / peak["divisions"],
        "gathers": loop["gathers_per_pair"] / peak["gathered"],
        "bytes": moved / peak["bytes"],
    }
    return {
        "case": case,
        "pairs": pairs,
        "us": micro,
        "ns_per_pair": 1e3 * micro["pair_forces"] / pairs,
        "bytes_per_pair": moved,
        **loop,
        "bounds_ns_per_pair": bounds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    repeats = 10 if parser.parse_args().quick else 50
    peak = core(repeats)
    data = ROOT / "tests" / "data" / "yade"
    rows = [
        row("disks-400", data / "packing.h5", 2, peak, repeats),
        row("spheres-1000", data / "spheres.h5", 3, peak, repeats),
    ]
    for line in rows:
        print(line["case"], {name: round(value, 2) for name, value in line["us"].items()}, "us")
    print(json.dumps({"core_per_ns": peak, "rows": rows}))


if __name__ == "__main__":
    main()
