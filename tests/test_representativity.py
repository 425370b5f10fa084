"""The study of packing sizes: rows, restart, figures."""

import json
from dataclasses import replace

import numpy as np
import pytest

from femxdem_fenicsx import representativity
from femxdem_fenicsx.dem.files import load_packing
from femxdem_fenicsx.dem.structure import structure_of
from femxdem_fenicsx.representativity import Study, draw, packing_path, run, summary, table

SMALL = Study(disks=(64, 100), spheres=(), seeds=2, strain=0.06)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    return folder, run(SMALL, folder, threads=2)


def _keys(rows):
    return [(row["dim"], row["grains"], row["seed"]) for row in rows]


def test_every_size_and_seed_has_a_row_and_a_packing(study):
    folder, rows = study
    assert _keys(rows) == SMALL.cases
    for row in rows:
        packing = load_packing(packing_path(folder, 2, row["grains"], row["seed"]))
        assert packing.size == row["grains"]
        assert structure_of(packing).void_ratio == row["void_ratio"]
        assert row["strain_reached"] == pytest.approx(0.06)
        assert 20 < row["peak_friction_angle"] < 45
    assert len({row["void_ratio"] for row in rows}) == len(rows)  # another packing for each seed


def test_rows_that_are_there_are_not_computed_again(study, monkeypatch):
    folder, rows = study
    computed = []

    def one(study, folder, dim, grains, seed):
        computed.append((dim, grains, seed))
        return dict(rows[0], dim=dim, grains=grains, seed=seed)

    monkeypatch.setattr(representativity, "_row", one)
    again = run(SMALL, folder)
    assert computed == [] and [r["void_ratio"] for r in again] == [r["void_ratio"] for r in rows]
    more = run(Study(disks=(64, 100), spheres=(), seeds=3, strain=0.06), folder)
    assert computed == [(2, 64, 3), (2, 100, 3)] and len(more) == 6
    assert [line.split(",")[:3] for line in (folder / "rows.csv").read_text().split()[1:]] == [
        [str(number) for number in case] for case in sorted(_keys(more))
    ]


@pytest.mark.parametrize(
    "changed", [{"strain": 0.1}, {"sphere_step": 1e-3}, {"tolerance": 1e-2}, {"pressure": 2e5}]
)
def test_another_test_in_the_same_folder_is_refused(study, changed):
    folder, _ = study
    with pytest.raises(ValueError, match="holds rows of another test") as error:
        run(replace(SMALL, **changed), folder)
    assert "\n" not in str(error.value)


def test_the_table_and_the_summary_have_mean_and_deviation(study):
    _, rows = study
    voids = np.array([row["void_ratio"] for row in rows[:2]])
    names, cells = table(rows, 2)
    assert names == ("grains", "64", "100") and cells[0] == ("packings", "2", "2")
    assert cells[1][1] == f"{voids.mean():.3f}±{voids.std(ddof=1):.3f}"
    columns, lines = summary(rows)
    assert lines[0]["void_ratio_mean"] == pytest.approx(voids.mean())
    assert lines[0]["void_ratio_deviation"] == pytest.approx(voids.std(ddof=1))
    assert set(columns) == set(lines[0]) and table(rows, 3) == (("grains",), table(rows, 3)[1])


def test_the_figures_are_drawn(study, tmp_path):
    folder, rows = study
    draw(SMALL, folder, rows)
    for name in ("disks", "structure"):
        assert (folder / f"{name}.png").stat().st_size > 10000
    assert not (folder / "spheres.png").exists()


def test_a_damaged_folder_or_study_is_refused(tmp_path):
    (tmp_path / "study.json").write_text("{")
    with pytest.raises(ValueError, match="damaged"):
        run(SMALL, tmp_path)
    (tmp_path / "study.json").write_text(json.dumps(SMALL.settings))
    (tmp_path / "rows.csv").write_text("grains,seed\n100,1\n")
    with pytest.raises(ValueError, match="this table is damaged"):
        run(SMALL, tmp_path)
    for values, told in (
        ({"seeds": 1}, "2 seeds or more"),
        ({"strain": 0.9}, "the strain must be in"),
        ({"pressure": np.nan}, "the pressure must be positive, got nan"),
        ({"disks": (), "spheres": ()}, "one size of packing or more"),
        ({"disks": (10,)}, "fewer than 50 grains"),
    ):
        with pytest.raises(ValueError, match=told):
            Study(**values)
