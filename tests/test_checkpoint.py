"""Checkpoints: whatever ends a run, on however many ranks it goes on, it goes on rightly."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from femxdem_fenicsx.checkpoint import (
    MANIFEST,
    SUMS,
    Checkpoint,
    CheckpointError,
    Checkpoints,
    Saving,
    Signals,
)
from tests.checkpoint_run import Counting, at_step
from tests.mpi import ROOT, run_on_ranks

MODULE = "tests.checkpoint_run"
#: Open MPI then starts no helper beside a process that is alone.
ALONE = {**os.environ, "OMP_NUM_THREADS": "1", "OMPI_MCA_ess_singleton_isolated": "1"}
SELF = MPI.COMM_SELF
STOPPED = 128 + signal.SIGTERM
END = "end=0.0135"  # with cut steps from 0.012 on


def write(folder: Path, *steps: int, scene=None) -> None:
    """Checkpoints of a counting run behind these steps."""
    counting = at_step(0, 50)
    checkpoints = Checkpoints(SELF, Saving(folder, scene or {}), {"rows": counting.part()})
    for step in range(1, max(steps) + 1):
        counting.advance()
        if step in steps:
            checkpoints.write(step, {"step": np.array(step)})


def specimen(folder: Path, *options: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", MODULE, "specimen", str(folder), *options]
    return subprocess.run(command, cwd=ROOT, env=ALONE, capture_output=True, text=True, timeout=200)


def history(folder: Path) -> str:
    return (folder / "history.csv").read_text()


def log(folder: Path) -> str:
    return (folder / "run.log").read_text()


# Killed


def test_a_run_killed_at_thirty_moments_goes_on_from_the_last_that_it_told(tmp_path):
    """Each life checks what it finds: not older than what was told, and right to the last bit."""
    command = [sys.executable, "-m", MODULE, "lives", str(tmp_path / "checkpoint"), "30"]
    run = subprocess.run(command, cwd=ROOT, env=ALONE, capture_output=True, text=True, timeout=200)
    assert run.returncode == 0, run.stdout + run.stderr
    told = json.loads(run.stdout)
    assert told["steps"] > 31
    assert told["partial"] > 3  # killed while writing


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of a run that nothing has stopped, with a checkpoint at its end alone."""
    folder = tmp_path_factory.mktemp("whole")
    run = specimen(folder, END, "every=1000")
    assert run.returncode == 0, run.stderr
    rows = history(folder).splitlines()
    assert any(row.split(",")[5] != "0" for row in rows[1:])  # steps are cut on the way
    return folder


@pytest.mark.parametrize(
    "trouble, code",
    [("kill=17", -signal.SIGKILL), ("kill=54", -signal.SIGKILL), ("term=165", STOPPED)],
)
def test_a_run_that_was_stopped_and_resumed_has_the_same_history_and_fields(
    whole, tmp_path, trouble, code
):
    run = specimen(tmp_path, END, trouble)
    assert run.returncode == code, run.stderr
    complete = readable(tmp_path)
    assert complete == len(history(tmp_path).splitlines())  # a row less, and the beginning
    run = specimen(tmp_path, END, "--resume")
    assert run.returncode == 0, run.stderr
    assert history(tmp_path) == history(whole)
    assert (tmp_path / "fields.xdmf").read_bytes() == (whole / "fields.xdmf").read_bytes()
    for file in (whole / "fields_fields").iterdir():
        assert (tmp_path / "fields_fields" / file.name).read_bytes() == file.read_bytes()
    assert "going on from" in log(tmp_path)
    if code > 0:
        assert "stopped by SIGTERM" in log(tmp_path)


def test_on_two_ranks_too_with_the_second_gradient_and_all_that_a_solver_keeps(
    tmp_path, monkeypatch
):
    # on several ranks MUMPS sums in the order in which messages arrive: one factorisation per rank
    redundant = "-femxdem_pc_type redundant -femxdem_redundant_pc_factor_mat_solver_type mumps"
    monkeypatch.setenv("PETSC_OPTIONS", f"-femxdem_snes_anderson_keep 1 {redundant}")
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    for folder, *options in ((whole, "every=1000"), (stopped, "kill=17"), (stopped, "--resume")):
        options += ["end=0.008", "modulus=0.5"]
        run = run_on_ranks(2, MODULE, "specimen", str(folder), *options)
        assert (run.returncode == 0) == ("kill=17" not in options), run.stderr
        if "kill=17" in options:
            assert 1 < len(history(stopped).splitlines()) < 5
    assert len(history(whole).splitlines()) == 5
    assert history(stopped) == history(whole)


def readable(folder: Path) -> int:
    """Number of times in the XDMF file, all of whose data can be read."""
    grids = ElementTree.parse(folder / "fields.xdmf").getroot().findall("Domain/Grid/Grid")
    for grid in grids:
        for item in grid.iter("DataItem"):
            file, dataset = item.text.split(":")
            with h5py.File(folder / file, "r") as h5:
                assert np.isfinite(h5[dataset][()]).all()
                assert list(h5[dataset].shape) == [int(n) for n in item.get("Dimensions").split()]
    return len(grids)


@pytest.fixture
def interruptible():
    """SIGINT as in the foreground: a process in the background may be started with it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_second_signal_acts_at_once(interruptible):
    with pytest.raises(KeyboardInterrupt), Signals() as signals:
        os.kill(os.getpid(), signal.SIGINT)
        assert signals.received == signal.SIGINT
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# Ranks


@pytest.mark.parametrize("before, after", [(1, 2), (2, 1)])
def test_another_number_of_ranks_finds_the_same_bits_and_goes_on(whole, tmp_path, before, after):
    found = []
    for ranks, *options in ((before, "end=0.008"), (after, "end=0.01", "--resume")):
        run = run_on_ranks(ranks, MODULE, "specimen", str(tmp_path), "digest", *options)
        assert run.returncode == 0, run.stderr
        found += run.stdout.split()
    written, taken_up, _ = found
    assert written == taken_up and len(written) == 64
    same_numbers(tmp_path, whole)


def same_numbers(folder: Path, whole: Path) -> None:
    found, expected = (
        np.genfromtxt(path / "history.csv", delimiter=",", names=True) for path in (folder, whole)
    )
    assert len(found) >= 5
    for name in found.dtype.names:
        np.testing.assert_allclose(found[name], expected[name][: len(found)], rtol=1e-8)


# Damaged, or another run's


def test_no_bit_flip_and_no_truncation_goes_unnoticed(tmp_path):
    write(tmp_path, 3)
    (path,) = tmp_path.iterdir()
    files = sorted(path.iterdir())
    assert [file.name for file in files] == [SUMS, MANIFEST, "rank_0000.h5"]
    random = np.random.default_rng(7)
    for trial in range(200):
        file = files[random.integers(3)]
        data = file.read_bytes()
        place = int(random.integers(len(data)))
        if trial % 4 == 0:
            file.write_bytes(data[:place])
        else:
            flipped = data[place] ^ 1 << int(random.integers(8))
            file.write_bytes(data[:place] + bytes([flipped]) + data[place + 1 :])
        with pytest.raises(ValueError, match=r"damaged|missing"):
            Checkpoint.last(SELF, tmp_path)
        file.write_bytes(data)
    assert Checkpoint.last(SELF, tmp_path).common["step"] == 3


def test_a_damaged_one_is_told_the_one_before_serves_and_the_damaged_one_goes(tmp_path):
    write(tmp_path, 3, 4)
    (tmp_path / "step_000004" / "rank_0000.h5").write_bytes(b"")
    saved = Checkpoint.last(SELF, tmp_path)
    assert saved.path.name == "step_000003"
    (refused,) = saved.refused
    assert "step_000004: rank_0000.h5 is truncated or damaged" in refused
    counting = Counting(np.arange(12), 50)
    saved.load({"rows": counting.part()})
    assert np.array_equal(counting.values, at_step(3, 50).values)
    Checkpoints(SELF, Saving(tmp_path, {}), {"rows": counting.part()}, goes_on=3)
    assert [path.name for path in tmp_path.iterdir()] == ["step_000003"]


def test_files_of_another_number_of_ranks_do_not_slip_in(tmp_path):
    write(tmp_path, 3)
    shutil.copy(tmp_path / "step_000003/rank_0000.h5", tmp_path / "step_000003/rank_0001.h5")
    with pytest.raises(ValueError, match=SUMS):
        Checkpoint.last(SELF, tmp_path)


def test_the_last_two_are_kept_and_another_run_does_not_touch_them(tmp_path):
    folder = tmp_path / "checkpoint"
    write(folder, 1, 2, 3, 4)
    assert sorted(path.name for path in folder.iterdir()) == ["step_000003", "step_000004"]
    write(folder, 1)
    assert [path.name for path in folder.iterdir()] == ["step_000001"]
    before = folder.with_name("checkpoint.before")
    assert sorted(path.name for path in before.iterdir()) == ["step_000003", "step_000004"]


def test_a_newer_format_is_refused_and_what_is_no_checkpoint_too(tmp_path):
    write(tmp_path, 3)
    for name, value, said in (("version", 99, "checkpoint format 99"), ("format", "x", "no check")):
        manifest = tmp_path / "step_000003" / MANIFEST
        with h5py.File(manifest, "r+") as file:
            file.attrs[name] = value
        sums = manifest.with_name(SUMS)
        lines = [line for line in sums.read_text().splitlines() if MANIFEST not in line]
        checksum = hashlib.sha256(manifest.read_bytes()).hexdigest()
        sums.write_text("\n".join([*lines, f"{checksum}  {MANIFEST}"]) + "\n")
        with pytest.raises(ValueError, match=said):
            Checkpoint.last(SELF, tmp_path)


def test_a_checkpoint_of_the_first_format_is_gone_on_with(tmp_path):
    """It was written by the biaxial demo; what it then went on to is beside it.

    Its time step was 0.8 of the limit without damping, now it is 0.95 of that with it.
    """
    stored = ROOT / "tests" / "data" / "checkpoint_1"
    shutil.copytree(stored / "step_000003", tmp_path / "checkpoint" / "step_000003")
    demo = """import runpy
from femxdem_fenicsx.dem.accuracy import PRESETS, Accuracy
PRESETS["fast"] = Accuracy(inertial_number=1e-2, tolerance=1e-2)  # as it was then
runpy.run_path("demos/biaxial.py", run_name="__main__")"""
    command = [sys.executable, "-c", demo, "--output", str(tmp_path), "--resume", "--quiet"]
    scene = ["--grains", "60", "--seed", "2", "--mesh", "1", "1", "--accuracy", "fast"]
    scene += ["--time-step", "0.8"]
    run = subprocess.run(
        [*command, *scene, "--strain", "0.005", "--tolerance", "1e-3"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    found, expected = (
        np.genfromtxt(folder / "history.csv", delimiter=",", names=True)
        for folder in (tmp_path, stored)
    )
    assert len(found) == len(expected) == 5
    for name in set(expected.dtype.names) - {"seconds"}:
        assert np.array_equal(found[name][:3], expected[name][:3]), name
    # time steps have become some 1e-4 longer since, and other solvers end as near: see its README
    for name in ("stress_ratio", "void_ratio"):
        np.testing.assert_allclose(found[name][3:], expected[name][3:], rtol=5e-3, err_msg=name)


def test_checksums_are_those_of_sha256sum(tmp_path):
    write(tmp_path, 3)
    command = ["sha256sum", "--check", "--strict", SUMS]
    assert (
        subprocess.run(command, cwd=tmp_path / "step_000003", capture_output=True).returncode == 0
    )


def test_another_scene_is_refused_with_what_differs(whole):
    before = history(whole)
    run = specimen(whole, END, "--resume", "threshold=0.021")
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    assert "the checkpoint of another run: threshold was 0.02, now it is 0.021" in run.stderr
    assert history(whole) == before


def test_an_option_that_an_older_program_did_not_know_must_have_its_default(tmp_path):
    write(tmp_path, 3, scene={"mesh": [2, 4]})
    saved = Checkpoint.last(SELF, tmp_path)
    scene, defaults = {"mesh": (2, 4), "gradient": "first"}, {"gradient": "first"}
    saved.check_scene(Saving(tmp_path, scene, defaults=defaults))
    for other in (scene | {"gradient": "second"}, {"gradient": "first"}):
        with pytest.raises(ValueError, match="the checkpoint of another run"):
            saved.check_scene(Saving(tmp_path, other, defaults=defaults))


def test_a_run_at_its_end_and_one_without_checkpoint_do_not_go_on(whole, tmp_path):
    run = specimen(whole, END, "--resume")
    assert run.returncode == 2 and "is reached already" in run.stderr
    run = specimen(tmp_path, END, "--resume")
    assert run.returncode == 2 and "there is no checkpoint to go on from" in run.stderr


def test_rows_that_are_not_there_are_missed(tmp_path):
    write(tmp_path, 3)
    with pytest.raises(ValueError, match="rows number 12 is not in this checkpoint"):
        Checkpoint.last(SELF, tmp_path).load({"rows": Counting(np.arange(13), 50).part()})
    with pytest.raises(ValueError, match=r"it holds \['rows'\]"):
        Checkpoint.last(SELF, tmp_path).load({})


# What cannot be written, and other failures of one rank


def test_a_full_disk_of_one_rank_leaves_the_older_checkpoint_and_both_ranks_say_so(tmp_path):
    run = run_on_ranks(2, MODULE, "full", str(tmp_path), timeout=60)
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout)
    expected = "step_000002: checkpoint not written: No space left on device; step_000001 stands"
    assert all(said.endswith(expected) for said in told["said"]) and len(told["said"]) == 2
    assert told["there"] == ["step_000001", "step_000003"]


@pytest.mark.parametrize("asked", ["go on", "stop"])
def test_files_that_may_not_grow_stop_the_checkpoints_and_the_run_if_so_asked(tmp_path, asked):
    assert specimen(tmp_path, "end=0.004").returncode == 0
    run = specimen(tmp_path, "end=0.008", "--resume", "limit=9000", asked)
    said = "step_000003: checkpoint not written: File too large; step_000002 stands"
    assert said in log(tmp_path)
    assert Checkpoint.last(SELF, tmp_path / "checkpoint").path.name == "step_000002"
    if asked == "stop":
        assert run.returncode == 2 and said in run.stderr and run.stderr.count("\n") == 1
        assert len(history(tmp_path).splitlines()) == 1 + 3
    else:
        assert run.returncode == 0, run.stderr
        assert len(history(tmp_path).splitlines()) == 1 + 4


@pytest.mark.parametrize("where", ["law", "output", "solve"])
def test_a_failure_on_one_rank_ends_both_with_its_message(tmp_path, where):
    run = run_on_ranks(2, MODULE, "specimen", str(tmp_path), END, f"{where}=3", timeout=60)
    assert run.returncode != 0
    lines = (line.strip(" \0") for line in run.stderr.splitlines())  # prterun may send a NUL
    told = [line for line in lines if line.startswith("error: ")]
    assert len(told) == 1, run.stderr
    assert f"no room in the {where}" in told[0]
    assert ("on rank 1" in told[0]) == (where != "output")
    assert "Traceback" not in run.stderr


def test_a_folder_that_cannot_be_tidied_is_one_error(tmp_path):
    write(tmp_path / "checkpoint", 1)
    (tmp_path / "checkpoint.before").write_text("in the way")
    with pytest.raises(CheckpointError):
        write(tmp_path / "checkpoint", 1)
