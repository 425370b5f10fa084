"""Which change of a source file makes a kernel be compiled anew."""

import pytest

from femxdem_fenicsx.dem.aliasing import fingerprint

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
