"""`femxdem packing`, as a user calls it."""

import subprocess
import sys

import numpy as np
import pytest

from femxdem_fenicsx.dem.files import load_packing, save_packing
from femxdem_fenicsx.dem.homogenisation import stress
from femxdem_fenicsx.dem.structure import structure_of
from tests.commands.lab import assert_refused, femxdem  # noqa: F401
from tests.dem.scenes import cubic, hexagonal
from tests.reference import DATA

SMALL = ("packing", "prepare", "--grains", 64)


def test_the_laboratory_runs_without_fenicsx():
    code = (
        "import sys; from femxdem_fenicsx import cli; cli.parser();"
        "print(sorted({'dolfinx', 'ufl', 'basix', 'petsc4py', 'mpi4py'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == "[]\n", done.stderr


def test_more_grains_than_there_is_memory_for_are_refused(femxdem, tmp_path):  # noqa: F811
    words = ("packing", "prepare", "--grains", 10**12, "--output", tmp_path / "a.h5")
    assert_refused(femxdem(*words), "Unable to allocate")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--pressure", -1), "pressure: give one positive value (Pa) or 2 of them, got -1.0"),
        (("--pressure", "nan"), "got nan"),
        (("--tolerance", 0), "tolerance of a pressure: it must be above 0 and below 1, got 0.0"),
        (("--tolerance", "nan"), "got nan"),
        (("--tolerance", "inf"), "got inf"),
        (("--grain-density", "inf"), "density of the grains: need a positive one (kg/m3), got inf"),
    ],
)
def test_a_target_that_is_none_is_refused_at_once(femxdem, tmp_path, words, told, monkeypatch):  # noqa: F811
    monkeypatch.setattr("femxdem_fenicsx.dem.preparation.compress", None)  # nothing is computed
    assert_refused(femxdem(*SMALL, "--output", tmp_path / "a.h5", *words), told)


def test_output_that_cannot_be_written_is_refused_before_anything_is_computed(femxdem, tmp_path):  # noqa: F811
    assert_refused(femxdem(*SMALL, "--output", "/proc/no/a.h5"), "/proc/no/a.h5: cannot write")
    words = ("tradeoff", "--packing", tmp_path / "none.h5", "--output", "/proc/no")
    assert_refused(femxdem(*words), "/proc/no: cannot write there")


def test_a_packing_is_prepared_as_asked(femxdem, tmp_path):  # noqa: F811
    path = tmp_path / "new" / "sand.h5"
    result = femxdem(
        *SMALL, "--output", path, "--pressure", 5e4, 6e4, "--density", "loose", "--modulus", 3e8,
        "--friction", 0.4, "--uniform", "volume", "--radii", 2e-3, 4e-3, "--seed", 3,
    )  # fmt: skip
    assert result.code == 0, result.error
    packing = load_packing(path)
    assert packing.size == 64 and packing.law.modulus == 3e8 and packing.law.friction == 0.4
    np.testing.assert_allclose(np.diag(stress(packing)), (-5e4, -6e4), rtol=2e-3)
    assert f"{packing.void_ratio:.4f}" in result.out and "rattlers" in result.out


def test_a_library_gets_numbered_files_with_the_same_grains(femxdem, tmp_path):  # noqa: F811
    result = femxdem(*SMALL, "--output", tmp_path / "sand.h5", "--count", 3)
    assert result.code == 0, result.error
    files = sorted(tmp_path.iterdir())
    assert [path.name for path in files] == ["sand-001.h5", "sand-002.h5", "sand-003.h5"]
    packings = [load_packing(path) for path in files]
    for packing in packings[1:]:
        np.testing.assert_array_equal(packing.radii, packings[0].radii)
        assert packing.void_ratio != packings[0].void_ratio
    voids = [packing.void_ratio for packing in packings]
    assert f"{np.mean(voids):.4f} ± {np.std(voids, ddof=1):.4f}" in result.out


def test_a_target_out_of_reach_keeps_what_was_reached(femxdem, tmp_path):  # noqa: F811
    path = tmp_path / "sand.h5"
    result = femxdem(*SMALL, "--output", path, "--void-ratio", 0.6)
    kept = tmp_path / "sand-reached.h5"
    assert_refused(result, "void ratio 0.6 was not reached", "at best", str(kept))
    assert not path.exists() and load_packing(kept).void_ratio < 0.3
    result = femxdem(*SMALL, "--output", path, "--pressure", 1e5, 3e6)
    assert_refused(result, "cannot bear these stresses", str(kept))
    reached = -np.diag(stress(load_packing(kept)))
    assert reached[1] < 2.7e6 and not path.exists()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--pressure", -1), "pressure"),
        (("--pressure", 1, 2, 3), "one value or 2"),
        (("--radii", 5e-3, 3e-3), "radii"),
        (("--density", "dry"), "invalid choice"),
        (("--density", "loose", "--compaction-friction", 0.1), "not allowed with"),
        (("--void-ratio", 0.2, "--density", "loose"), "void-ratio"),
        (("--void-ratio", -0.2), "void ratio"),
        (("--count", 0), "--count"),
        (("--count", 2, "--arrangement", "hexagonal"), "the same"),
        (("--friction", -0.5), "friction"),
        (("--grains", "many"), "invalid int"),
        (("--colour", "red"), "unrecognized"),
        (("--sieve", "nowhere.csv"), "nowhere.csv"),
    ],
)
def test_a_request_that_is_none_is_one_line_and_no_file(femxdem, tmp_path, words, complaint):  # noqa: F811
    result = femxdem(*SMALL, "--output", tmp_path / "sand.h5", *words)
    assert_refused(result, complaint)
    assert not list(tmp_path.iterdir())


def test_a_sieve_curve_that_does_not_increase_names_the_sieves(femxdem, tmp_path):  # noqa: F811
    curve = tmp_path / "curve.csv"
    curve.write_text("2,0\n4,60\n8,50\n")
    assert_refused(femxdem(*SMALL, "--sieve", curve), str(curve), "from sieve 2 to 3")


def test_info_says_what_is_in_a_file_of_either_dimension(femxdem, tmp_path):  # noqa: F811
    path = tmp_path / "spheres.h5"
    save_packing(path, cubic())
    result = femxdem("packing", "info", path, DATA / "packing.h5")
    assert result.code == 0
    disks = structure_of(load_packing(DATA / "packing.h5"))
    for words in ("64 spheres", "400 disks", "6.000", f"{disks.void_ratio:.4f}", "rattlers"):
        assert words in result.out
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(path.read_bytes()[:1000])
    assert_refused(femxdem("packing", "info", damaged), str(damaged), "damaged")
    assert_refused(femxdem("packing", "info", tmp_path / "none.h5"), "no such packing file")


def test_plot_draws_disks_and_spheres(femxdem, tmp_path):  # noqa: F811
    for name, packing in (("disks", hexagonal()), ("spheres", cubic())):
        save_packing(tmp_path / f"{name}.h5", packing)
        result = femxdem("packing", "plot", tmp_path / f"{name}.h5")
        assert result.code == 0 and result.out == f"{tmp_path / name}.png\n"
        assert (tmp_path / f"{name}.png").stat().st_size > 5000
    refused = femxdem("packing", "plot", tmp_path / "disks.h5", "--output", tmp_path / "x.txt")
    assert_refused(refused, "a picture ends in")


def test_grains_go_to_a_table_and_come_back(femxdem, tmp_path):  # noqa: F811
    packing = hexagonal()
    source, table, target = (tmp_path / name for name in ("a.h5", "a.csv", "b.h5"))
    save_packing(source, packing)
    assert femxdem("packing", "convert", source, table).code == 0
    box = np.diag(packing.box)
    result = femxdem("packing", "convert", table, target, "--box", *box, "--modulus", 1e8)
    assert result.code == 0, result.error
    again = load_packing(target)
    np.testing.assert_array_equal(again.radii, packing.radii)
    np.testing.assert_allclose(again.positions, packing.positions, atol=1e-15)
    assert again.law.modulus == 1e8
    assert femxdem("packing", "convert", source, tmp_path / "a.vtp").code == 0
    assert (tmp_path / "a.vtp").read_text().startswith("<?xml")
    assert_refused(femxdem("packing", "convert", source, tmp_path / "a.xyz"), "unknown format")
    assert_refused(femxdem("packing", "convert", table, target), "--box")
    table.write_text("x_m,y_m,radius_m\n0,0,\n")
    assert_refused(femxdem("packing", "convert", table, target, "--box", 1, 1), "no number")
    table.write_text("x_m,radius_m\n0,1\n")
    assert_refused(femxdem("packing", "convert", table, target, "--box", 1, 1), "'y_m'")
