"""Which change compiles a kernel anew, and that no state of the cache stops a process."""

import errno
import importlib.util
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numba
import pytest
from numba.core import config

from femxdem_fenicsx.dem import kernel_cache
from femxdem_fenicsx.dem.kernel_cache import KernelCache, fingerprint

SOURCES = {
    "kernel.py": "from .helper import add\nfrom . import law",
    "helper.py": "from .package import deep",
    "law.py": "",
    "package/__init__.py": "from .deep import x",
    "package/deep.py": "x = 1",
    "stranger.py": "from .kernel import step",
}


def written(folder, **changed):
    """The fingerprint of kernel.py in a package with some files changed."""
    for name, text in SOURCES.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + changed.get(path.stem, ""))
    return fingerprint(folder / "kernel.py")


@pytest.mark.parametrize("changed", ["kernel", "helper", "law", "deep"])
def test_a_change_of_a_file_that_a_kernel_imports_compiles_it_anew(tmp_path, changed):
    before = written(tmp_path / "before")
    assert written(tmp_path / "after", **{changed: "\n# another line"}) != before


def test_a_change_of_any_other_file_does_not(tmp_path):
    before = written(tmp_path / "before")
    assert written(tmp_path / "after", stranger="\n# another line") == before


TINY = """
from femxdem_fenicsx.dem.aliasing import kernel

@kernel
def double(x):
    return x + x
"""


@pytest.fixture
def process(tmp_path, monkeypatch):
    """Each call gives the kernel `double` as a new process finds it, with a cache in tmp_path."""
    monkeypatch.setattr(kernel_cache, "_given", [])
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "tiny.py"
    path.write_text(TINY)

    def double():
        spec = importlib.util.spec_from_file_location("tiny", path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "tiny", module)
        spec.loader.exec_module(module)
        return module.double

    return double


@pytest.fixture
def no_folder(tmp_path, monkeypatch):
    """No folder can be written, by whomever: it would have to be below a file."""
    (tmp_path / "file").touch()
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(config, "CACHE_LOCATOR_CLASSES", "UserProvidedCacheLocator")


def files(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file())


def hits(double):
    return sum(double.stats.cache_hits.values())


def test_the_next_process_finds_every_kernel_and_nothing_else_is_written(process, tmp_path):
    with warnings.catch_warnings(action="error"):
        double = process()
        assert (double(2), double(1.5), hits(double)) == (4, 3.0, 0)
        double = process()
        assert (double(2), double(1.5), hits(double)) == (4, 3.0, 2)
    assert [path.suffix for path in files(tmp_path / "cache")] == [".nbc", ".nbc"]


def test_processes_that_fill_one_cache_at_once_lose_nothing(process):
    """Both have seen it empty; numba would have numbered both kernels 1."""
    one, other = process(), process()
    assert (one(2), other(1.5)) == (4, 3.0)
    assert (one(1.5), other(2)) == (3.0, 4)
    double = process()
    assert (double(2), double(1.5), hits(double)) == (4, 3.0, 2)


DAMAGE = {
    "empty": lambda good, other: b"",
    "cut in the digest": lambda good, other: good[:20],
    "cut in the data": lambda good, other: good[: len(good) // 2],
    "longer": lambda good, other: good + b"x",
    "one bit": lambda good, other: good[:2000] + bytes([good[2000] ^ 1]) + good[2001:],
    "text": lambda good, other: b"no kernel at all",
    "another kernel's": lambda good, other: other,
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_replaced(process, tmp_path, damage):
    assert process()(1.5) == 3.0
    (file,) = files(tmp_path / "cache")
    good = file.read_bytes()
    assert process()(2) == 4
    (other,) = set(files(tmp_path / "cache")) - {file}
    file.write_bytes(DAMAGE[damage](good, other.read_bytes()))
    with warnings.catch_warnings(action="error"):
        for expected in (0, 1):
            double = process()
            assert (double(1.5), hits(double)) == (3.0, expected)


@pytest.mark.parametrize("changed", ["numba", "source"])
def test_a_file_of_another_numba_or_source_is_replaced(process, tmp_path, monkeypatch, changed):
    process()(1.5)
    if changed == "numba":
        monkeypatch.setattr(numba, "__version__", "0")
    else:
        monkeypatch.setattr(kernel_cache, "fingerprint", lambda path: "another")
    for expected in (0, 1):
        double = process()
        assert (double(1.5), hits(double)) == (3.0, expected)
    assert len(files(tmp_path / "cache")) == 1


def test_a_flush_forgets_all_kernels_of_the_function(process, tmp_path):
    double = process()
    double(2), double(1.5)
    double._cache.flush()
    assert files(tmp_path / "cache") == []


def one_warning_naming(folder, *kernels):
    """Call all kernels: right, and with one warning in one line, of this folder."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        for double in kernels:
            assert (double(2), double(1.5)) == (4, 3.0)
    (warning,) = caught
    text = str(warning.message)
    assert str(folder) in text and "NUMBA_CACHE_DIR" in text and "\n" not in text
    return text


def test_a_full_folder_is_one_warning_and_nothing_half_written_stays(
    process, tmp_path, monkeypatch
):
    def write_half(path, data):
        with path.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", write_half)
    text = one_warning_naming(tmp_path / "cache", process(), process())
    assert os.strerror(errno.ENOSPC) in text
    assert files(tmp_path / "cache") == []


def test_a_file_that_can_be_neither_read_nor_replaced_is_one_warning(process, tmp_path):
    double = process()
    double(2), double(1.5)
    for file in files(tmp_path / "cache"):
        file.unlink()
        file.mkdir()
    one_warning_naming(tmp_path / "cache", process(), process())


def test_a_folder_that_is_lost_while_the_process_runs_is_one_warning(process, tmp_path):
    double = process()
    (folder,) = (tmp_path / "cache").iterdir()
    folder.rmdir()
    folder.touch()
    one_warning_naming(folder, double)


@pytest.mark.parametrize("step", ["reduce", "rebuild"])
def test_whatever_numba_cannot_store_or_read_is_one_warning(process, tmp_path, monkeypatch, step):
    def fail(*arguments):
        raise EOFError("two\nlines")

    process()(1.5)
    monkeypatch.setattr(KernelCache._impl_class, step, fail)
    assert "EOFError: two lines" in one_warning_naming(tmp_path / "cache", process())


def test_without_any_folder_the_first_kernel_compiled_is_one_warning(process, tmp_path, no_folder):
    with warnings.catch_warnings(action="error"):
        one, other = process(), process()
    one_warning_naming(tmp_path / "file" / "cache", one, other)


def of_process(tmp_path, *command):
    """stderr of Python with a cache folder that cannot be there."""
    (tmp_path / "file").touch()
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path / "file" / "cache"),
        "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator",
        "PYTHONPATH": str(Path(__file__).parents[2]),
    }
    run = subprocess.run(
        [sys.executable, *command], env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    return run.stderr


def test_without_any_folder_the_command_line_answers(tmp_path):
    assert of_process(tmp_path, "-m", "femxdem_fenicsx.cli", "--help") == ""


def test_the_warning_is_one_line_on_the_terminal(tmp_path):
    (tmp_path / "tiny.py").write_text(TINY + "print(double(2), double(1.5))")
    (line,) = of_process(tmp_path, tmp_path / "tiny.py").splitlines()
    assert str(tmp_path / "file" / "cache") in line
