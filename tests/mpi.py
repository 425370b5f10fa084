"""Runs a module of the tests on several ranks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def run_on_ranks(
    ranks: int, module: str, *arguments: str, timeout: float = 120
) -> subprocess.CompletedProcess:
    """Run ``python -m module arguments`` on `ranks` ranks; its output is in the result.

    Raises:
        subprocess.TimeoutExpired: it hangs.
    """
    command = ["mpirun", "--oversubscribe", "-n", str(ranks)]
    if os.geteuid() == 0:
        command.insert(1, "--allow-run-as-root")
    command += [sys.executable, "-m", module, *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=timeout
    )
