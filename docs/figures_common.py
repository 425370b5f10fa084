"""What the figures_*.py share: running the program, and the small tables beside the pictures."""

import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures"
RESULTS = ROOT / "results"
YADE = ROOT / "tests" / "data" / "yade"
sys.path[:0] = [str(ROOT), str(ROOT / "demos"), str(ROOT / "benchmarks")]

from femxdem_fenicsx import plotting  # noqa: E402

OURS, THEIRS, THIRD = plotting.COLOURS[:3]
#: The packing of the demo in the pictures.
PACKING = YADE / "packing.h5"


def python(script: str, *arguments: object) -> str:
    """Run a script of this repository; its output. A demo whose load path ends early is fine."""
    done = subprocess.run(
        [sys.executable, str(ROOT / script), *map(str, arguments)],
        stdout=subprocess.PIPE,
        text=True,
    )
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{script} ended with exit code {done.returncode}")
    return done.stdout


def table(name: str) -> np.ndarray:
    """One of the tables beside the figures, columns by name."""
    return np.genfromtxt(FIGURES / f"{name}.csv", delimiter=",", names=True)


def keep(name: str, columns: str, rows: np.ndarray) -> None:
    """Write a table beside the figures."""
    np.savetxt(
        FIGURES / f"{name}.csv", rows, fmt="%.6g", delimiter=",", header=columns, comments=""
    )


def femxdem(*arguments: object) -> str:
    """A command of the laboratory; its output. A test that ends early is fine."""
    command = [sys.executable, "-m", "femxdem_fenicsx.cli", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    if done.returncode not in (0, 3):
        raise RuntimeError(f"femxdem {arguments} ended with exit code {done.returncode}")
    return done.stdout


def keep_picture(source: Path, name: str) -> None:
    """Copy a picture with 256 colours: smaller files."""
    with Image.open(source) as picture:
        picture.convert("RGB").quantize(256).save(FIGURES / f"{name}.png")
