"""Demos with spheres: the triaxial test, and the biaxial one in plane strain."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.element_tests import drained_compression
from femxdem_fenicsx.dem.files import load_packing
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from tests.mpi import ROOT, run_on_ranks
from tests.reference import DATA

PACKING = DATA / "spheres.h5"


def run(demo: str, *arguments: object, timeout: float = 300) -> subprocess.CompletedProcess:
    command = [sys.executable, f"demos/{demo}.py", *map(str, arguments)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=timeout
    )


def history(folder: Path) -> np.ndarray:
    return np.genfromtxt(folder / "history.csv", delimiter=",", names=True)


@pytest.fixture(scope="module")
def single_element(tmp_path_factory):
    """Folder of one H8 with 8 points, to 0.6 %."""
    folder = tmp_path_factory.mktemp("triaxial")
    result = run(
        "triaxial", "--packing", PACKING, "--mesh", 1, 1, 1, "--size", 0.05, 0.05, 0.05,
        "--tolerance", 2e-3, "--max-iterations", 40, "--strain", 0.006, "--output", folder,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "peak friction angle" in result.stdout
    return folder


def test_one_element_answers_like_its_packing_on_its_own(single_element):
    rows = history(single_element)
    assert rows["converged"].all()
    law = HomogenisedLaw(load_packing(PACKING, 3), 1, PRESETS["balanced"])
    states = list(drained_compression(law, 1e5, 0.006, 1e-3, free_shear=True, tolerance=2e-3))
    strain = np.array([state.axial_strain for state in states])
    same = [int(np.abs(rows["axial_strain"] - s).argmin()) for s in strain]
    np.testing.assert_allclose(rows["axial_strain"][same], strain, atol=1e-9)
    off = np.abs(rows["stress_ratio"][same] / [s.stress_ratio for s in states] - 1)
    assert off[strain < 0.0055].max() < 3e-2
    # the peak is at 0.3 %; far behind it the packing rearranges, and the two paths part
    assert off.max() < 5e-2
    volume = np.array([state.volumetric_strain for state in states])
    change = np.abs(rows["volumetric_strain"][same] - volume)
    assert change.max() < 5e-2 * volume.max()


def test_the_triaxial_test_leaves_its_files(single_element):
    assert load_packing(single_element / "packing.h5", 3).size == 1000
    assert (single_element / "history.png").stat().st_size > 5000
    found = fields(single_element / "triaxial.xdmf")
    assert found["stress"].size == 9 and found["stress"].ravel()[8] < -2e5
    assert {"displacement", "void_ratio", "fabric_anisotropy"} <= set(found)


def fields(path: Path) -> dict[str, np.ndarray]:
    """The attributes of the last step."""
    last = ElementTree.parse(path).getroot().findall("Domain/Grid/Grid")[-1]
    found = {}
    for attribute in last.findall("Attribute"):
        file, dataset = attribute.find("DataItem").text.strip().split(":")
        with h5py.File(path.parent / file) as opened:
            found[attribute.get("Name")] = opened[dataset][()]
    return found


def test_one_and_two_ranks_give_the_same_triaxial_test(tmp_path):
    rows = []
    for ranks in (1, 2):
        folder = tmp_path / str(ranks)
        result = run_on_ranks(
            ranks, "demos.triaxial", "--packing", str(PACKING), "--mesh", "1", "1", "2",
            "--element", "T4", "--strain", "0.002", "--accuracy", "fast",
            "--output", str(folder), "--quiet", timeout=300,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
        rows.append(history(folder))
    one, two = rows
    assert len(one) == len(two) == 2
    for name in ("axial_strain", "stress_ratio", "volumetric_strain", "void_ratio"):
        np.testing.assert_allclose(two[name], one[name], rtol=1e-8, atol=1e-12, err_msg=name)
    for name in ("iterations", "evaluations", "cuts", "dem_steps", "failed_points"):
        np.testing.assert_array_equal(two[name], one[name], err_msg=name)


def test_plane_strain_over_spheres_tells_the_stress_out_of_the_plane(tmp_path):
    result = run(
        "biaxial", "--dim", 3, "--packing", PACKING, "--mesh", 1, 2, "--element", "Q4",
        "--strain", 0.002, "--output", tmp_path,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    rows = history(tmp_path)
    assert len(rows) == 2 and rows["converged"].all()
    ratio = rows["out_of_plane_stress_Pa"] / 1e5
    assert (1.2 < ratio).all() and (ratio < rows["stress_ratio"]).all()
    found = fields(tmp_path / "biaxial.xdmf")
    assert -found["out_of_plane_stress"].mean() == pytest.approx(1e5 * ratio[-1], rel=1e-3)
    assert load_packing(tmp_path / "packing_in.h5", 3).size == 1000
    assert (tmp_path / "fields.png").exists() and not (tmp_path / "force_chains.png").exists()


@pytest.mark.parametrize(
    "demo, arguments, message",
    [
        ("triaxial", ("--element", "Q4"), "Q4 is for 2D: choose one of H8"),
        ("triaxial", ("--packing", DATA / "packing.h5"), "2 dimensions, need 3"),
        ("triaxial", ("--mesh", 1, 1, 0), "one at least"),
        ("biaxial", ("--element", "H8"), "H8 is for 3D: choose one of Q4"),
        ("biaxial", ("--packing", PACKING), "3 dimensions, need 2"),
        ("biaxial", ("--dim", 4), "disks (2) or spheres (3)"),
    ],
)
def test_bad_input_gets_one_line_and_exit_code_two(demo, arguments, message, tmp_path):
    result = run(demo, "--packing", PACKING, *arguments, "--output", tmp_path / "results")
    assert result.returncode == 2, result.stderr
    assert result.stderr.startswith("error: ") and len(result.stderr.splitlines()) == 1
    assert message in result.stderr
