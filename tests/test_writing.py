"""Files appear whole or not at all."""

import json
from pathlib import Path

import pytest

from femxdem_fenicsx.writing import aside, check_writable, write_csv, write_json


def test_a_file_that_fails_half_way_leaves_the_old_one_and_nothing_else(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with pytest.raises(KeyError):
        write_csv(path, ("a", "b"), [{"a": 1, "b": 2}, {"a": 1}])
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
    write_csv(path, ("a", "b"), [{"a": 1, "b": 0.1}])
    assert path.read_text() == "a,b\n1,0.1\n"


def test_the_file_is_not_there_before_it_is_complete(tmp_path):
    path = tmp_path / "new" / "file.png"
    with aside(path) as beside:
        beside.write_text("half")
        assert not path.exists() and beside.suffix == ".png"
    assert path.read_text() == "half" and list(path.parent.iterdir()) == [path]


def test_numbers_that_are_not_finite_are_never_written(tmp_path):
    with pytest.raises(ValueError):
        write_json(tmp_path / "result.json", {"angle": float("nan")})
    assert not list(tmp_path.iterdir())
    write_json(tmp_path / "result.json", {"angle": None})
    assert json.loads((tmp_path / "result.json").read_text()) == {"angle": None}


def test_a_place_where_nothing_can_be_written_is_told_beforehand_and_nothing_is_made(tmp_path):
    (tmp_path / "file").write_text("")
    for good in ("file", "folder/of/a.h5", ""):
        check_writable(tmp_path / good)
    for bad in (tmp_path / "file" / "a.h5", Path("/proc/no/such/a.h5"), Path("/proc")):
        with pytest.raises(OSError, match=f"^{bad}: cannot write there: "):
            check_writable(bad)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
