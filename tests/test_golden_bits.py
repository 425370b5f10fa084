"""The same bits from a seed to a stress: for all kinds of CPU, caches, BLAS and numbers of ranks.

Numba compiles for the CPU that NUMBA_CPU_NAME names, OpenBLAS takes the code for the one that
OPENBLAS_CORETYPE names; each run is a process of its own.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from llvmlite.binding import get_host_cpu_features

from tests.golden_run import disks, spheres
from tests.mpi import run_on_ranks

GOLDEN = json.loads((Path(__file__).parent / "data" / "golden.json").read_text())

#: Names of CPUs in LLVM's words, and an instruction set that this machine must have to run their
#: code.
CPUS = {"generic": "sse2", "haswell": "avx2", "skylake-avx512": "avx512f"}
HERE = get_host_cpu_features()
NAMES = [name for name, feature in CPUS.items() if HERE.get(feature)]
BLAS = ["Prescott", *(["Haswell", "Zen"] if HERE.get("avx2") else [])]


def hashes(found: dict) -> dict:
    return {name: value for name, value in found.items() if isinstance(value, str)}


def of_process(*parts: str, **environment: str) -> dict:
    """What another process finds."""
    process = subprocess.run(
        [sys.executable, "-m", "tests.golden_run", *parts],
        cwd=Path(__file__).parents[1], env={**os.environ, **environment},
        capture_output=True, text=True,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout)


@pytest.mark.parametrize("part", [disks, spheres])
def test_a_packing_and_its_element_test_have_the_golden_bits(part):
    assert hashes(part()) == hashes(GOLDEN[part.__name__])


@pytest.mark.parametrize("name", NAMES)
def test_code_for_another_cpu_gives_them_too_compiled_anew_and_from_the_cache(name, tmp_path):
    environment = {"NUMBA_CPU_NAME": name, "NUMBA_CACHE_DIR": str(tmp_path)}
    first = of_process("disks", **environment)
    assert any(tmp_path.rglob("*.nbc"))
    assert first == of_process("disks", **environment)
    assert hashes(first["disks"]) == hashes(GOLDEN["disks"])


def test_spheres_give_them_for_any_cpu_too(tmp_path):
    environment = {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(tmp_path)}
    assert hashes(of_process("spheres", **environment)["spheres"]) == hashes(GOLDEN["spheres"])


@pytest.mark.parametrize("blas", BLAS)
def test_blas_for_another_cpu_changes_no_bit_of_packings_tests_and_coupled_runs(blas):
    for part, found in of_process(OPENBLAS_CORETYPE=blas).items():
        assert hashes(found) == hashes(GOLDEN[part])


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_coupled_run_ends_with_the_golden_packings_on_any_number_of_ranks(ranks):
    process = run_on_ranks(ranks, "tests.golden_run", "coupled")
    assert process.returncode == 0, process.stderr
    found = json.loads(process.stdout)["coupled"]
    assert hashes(found) == hashes(GOLDEN["coupled"])
    assert found["last_force_N"] == pytest.approx(GOLDEN["coupled"]["last_force_N"], rel=1e-8)
