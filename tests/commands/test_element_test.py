"""`femxdem element-test` and `calibrate`, as a user calls them."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

from femxdem_fenicsx.calibration import Laboratory, Target
from femxdem_fenicsx.dem.files import load_packing, save_packing
from femxdem_fenicsx.dem.homogenisation import stress
from femxdem_fenicsx.dem.preparation import GUO_ZHAO, random_packing
from tests.commands.lab import assert_refused, femxdem  # noqa: F401
from tests.reference import DATA


@pytest.fixture(scope="module")
def sand(tmp_path_factory):
    """A small dense packing in a file."""
    path = tmp_path_factory.mktemp("packing") / "sand.h5"
    save_packing(path, random_packing(100, seed=2))
    return path


def rows(path) -> np.ndarray:
    return np.genfromtxt(path, delimiter=",", names=True)


def test_a_biaxial_test_leaves_table_picture_summary_and_packing(femxdem, sand, tmp_path):  # noqa: F811
    result = femxdem(
        "element-test", "biaxial", "--packing", sand, "--strain", 0.04, "--output", tmp_path
    )
    assert result.code == 0, result.error
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {"biaxial.csv", "biaxial.png", "biaxial.json", "biaxial-end.h5"}
    table = rows(tmp_path / "biaxial.csv")
    told = json.loads((tmp_path / "biaxial.json").read_text())
    assert table["strain_yy"][-1] == pytest.approx(0.04) and len(table) == 45
    good = table["reached"] == 1
    assert np.abs(table["stress_xx_Pa"][good] - 1e5).max() < 400
    ratio = (table["stress_yy_Pa"] / table["stress_xx_Pa"]).max()
    # principal stresses of a box that bears some shear are a little further apart than its sides'
    lowest = np.degrees(np.arcsin((ratio - 1) / (ratio + 1)))
    assert lowest - 0.5 < told["peak_friction_angle"] < lowest + 2
    assert 24 < told["peak_friction_angle"] < 38
    assert 1.5e7 < told["young_modulus_Pa"] < 4e7 and 0 < told["poisson_ratio"] < 0.4
    at_end = load_packing(tmp_path / "biaxial-end.h5")
    assert at_end.void_ratio == pytest.approx(table["void_ratio"][-1])
    assert -stress(at_end)[1, 1] == pytest.approx(table["stress_yy_Pa"][-1], rel=1e-6)
    for words in ("peak friction angle", "dilatancy angle", "young modulus", "poisson ratio"):
        assert words in result.out


def test_moduli_of_the_tests_agree_with_each_other(femxdem, sand, tmp_path):  # noqa: F811
    """An isotropic solid in the plane has K = E / 2 (1 - nu) and M = E / (1 - nu^2)."""
    told = {}
    for name, *words in (
        ("biaxial", "--strain", 0.001),
        ("oedometric", "--strain", 0.001),
        ("isotropic", "--to", 1.01e5, "--increments", 1),
    ):
        result = femxdem(
            "element-test", name, "--packing", sand, "--output", tmp_path, "--quiet",
            "--accuracy", "reference", *words,
        )  # fmt: skip
        assert result.code == 0 and result.out == "", result
        told |= json.loads((tmp_path / f"{name}.json").read_text())
    young, poisson = told["young_modulus_Pa"], told["poisson_ratio"]
    assert told["oedometric_modulus_Pa"] == pytest.approx(young / (1 - poisson**2), rel=0.1)
    assert told["bulk_modulus_Pa"] == pytest.approx(young / (2 * (1 - poisson)), rel=0.15)


def test_another_pressure_is_consolidated_to_before(femxdem, sand, tmp_path):  # noqa: F811
    result = femxdem(
        "element-test", "undrained", "--packing", sand, "--pressure", 2e5, "--strain", 0.005,
        "--output", tmp_path,
    )  # fmt: skip
    assert result.code == 0, result.error
    table = rows(tmp_path / "undrained.csv")
    assert table["pressure_Pa"][0] == pytest.approx(2e5, rel=5e-3)
    assert abs(table["strain_yy"][0]) < 1e-15  # strain counts from there
    np.testing.assert_allclose(table["volumetric_strain"], 0.0, atol=1e-9)
    assert table["void_ratio"][0] < load_packing(sand).void_ratio


def test_cyclic_shear_under_stress_control_from_the_command_line(femxdem, sand, tmp_path):  # noqa: F811
    result = femxdem(
        "element-test", "cyclic-shear", "--packing", sand, "--shear-stress", 2e4, "--cycles", 1,
        "--normal-stress", 1e5, "--output", tmp_path,
    )  # fmt: skip
    assert result.code == 0, result.error
    table = rows(tmp_path / "cyclic-shear.csv")
    assert table["tau_xy_Pa"].max() > 2e4 and table["tau_xy_Pa"].min() < -2e4
    good = table["reached"] == 1
    assert np.abs(table["stress_yy_Pa"][good][1:] - 1e5).max() < 400
    assert json.loads((tmp_path / "cyclic-shear.json").read_text())["liquefied"] is False


def test_a_path_from_a_file_and_one_with_a_gap(femxdem, sand, tmp_path):  # noqa: F811
    path = tmp_path / "mine.csv"
    path.write_text("stress_xx_Pa,stress_yy_Pa,increments\n1.2e5,1e5,3\n1.2e5,1.4e5,4\n")
    words = ("element-test", "path", "--packing", sand, "--path", path, "--output", tmp_path)
    result = femxdem(*words)
    assert result.code == 0, result.error
    table = rows(tmp_path / "path.csv")
    assert table["stress_xx_Pa"][-1] == pytest.approx(1.2e5, rel=5e-3)
    assert table["stress_yy_Pa"][-1] == pytest.approx(1.4e5, rel=5e-3)
    broken = tmp_path / "broken.csv"
    broken.write_text("stress_xx_Pa,stress_yy_Pa\n1.2e5,1e5\n1.2e5,\n")
    before = set(tmp_path.iterdir())
    result = femxdem(
        "element-test", "path", "--packing", sand, "--path", broken, "--output", tmp_path
    )
    assert_refused(result, str(broken), "row 2", "gap")
    path.rename(tmp_path / "path.csv")
    words = ("element-test", "path", "--packing", sand, "--output", tmp_path, "--path")
    assert_refused(femxdem(*words, tmp_path / "path.csv"), "would overwrite it")
    assert len(set(tmp_path.iterdir())) == len(before) - 1


def test_probes_draw_an_envelope(femxdem, sand, tmp_path):  # noqa: F811
    for by in ("strain", "stress"):
        result = femxdem(
            "element-test", "probes", "--packing", sand, "--by", by, "--directions", 6,
            "--output", tmp_path,
        )  # fmt: skip
        assert result.code == 0, result.error
        table = rows(tmp_path / "probes.csv")
        size = np.hypot(table[f"lateral_{by}" + "_Pa" * (by == "stress")],
                        table[f"axial_{by}" + "_Pa" * (by == "stress")])  # fmt: skip
        np.testing.assert_allclose(size, size.mean(), rtol=3e-2)
        told = json.loads((tmp_path / "probes.json").read_text())
        assert 5 < told["smallest_stiffness_MPa"] < told["largest_stiffness_MPa"] < 60


def test_a_test_that_loses_control_ends_with_its_states_and_code_3(femxdem, sand, tmp_path):  # noqa: F811
    result = femxdem(
        "element-test", "path", "--packing", sand, "--output", tmp_path, "--path",
        written(tmp_path / "much.csv", "stress_xx_Pa,stress_yy_Pa,increments\n1e5,6e5,6\n"),
    )  # fmt: skip
    assert result.code == 3, result
    told = json.loads((tmp_path / "path.json").read_text())
    assert told["ended_early"] in result.out and "stress off by" in told["ended_early"]
    table = rows(tmp_path / "path.csv")
    assert len(table) == told["increments"] + 1 and table["stress_yy_Pa"][-1] > 1.5e5


def written(path, text: str):
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("triaxial",), "needs spheres"),
        (("true-triaxial",), "needs spheres"),
        (("biaxial", "--strain", 2), "need 0 < step <= strain < 1"),
        (("biaxial", "--step", 0), "need 0 < step"),
        (("biaxial", "--pressure", -1e5), "pressure must be positive"),
        (("biaxial", "--tolerance", 0), "tolerance must be"),
        (("biaxial", "--accuracy", "perfect"), "invalid choice"),
        (("cyclic-shear", "--amplitude", 0.01, "--shear-stress", 1e4), "not both"),
        (("cyclic-shear", "--cycles", 0), "--cycles"),
        (("cyclic-shear", "--shear-stress", -1e4), "must be positive"),
        (("isotropic", "--to", -1), "--to"),
        (("probes", "--directions", 2), "3 directions"),
        (("probes", "--size", 0), "size must be positive"),
        (("biaxial", "--pressure", 1e12), "overlap by about 100% of their diameter"),
        (("isotropic", "--to", 1e12), "overlap by about 100% of their diameter"),
        (("path", "--path", "nowhere.csv"), "nowhere.csv"),
        (("path",), "--path"),
        (("twist",), "invalid choice"),
    ],
)
def test_a_request_that_is_none_is_one_line_and_no_file(femxdem, sand, tmp_path, words, complaint):  # noqa: F811
    name, *rest = words
    result = femxdem("element-test", name, "--packing", sand, "--output", tmp_path, *rest)
    assert_refused(result, complaint)
    assert not list(tmp_path.iterdir())


def test_spheres_are_refused_where_disks_are_needed_and_a_missing_file_is_named(femxdem, tmp_path):  # noqa: F811
    result = femxdem("element-test", "biaxial", "--packing", DATA / "spheres.h5")
    assert_refused(result, "needs disks")
    result = femxdem("element-test", "biaxial", "--packing", tmp_path / "none.h5")
    assert_refused(result, "no such packing file")


@pytest.mark.parametrize("b", [None, 0.5], ids=["triaxial", "true triaxial"])
def test_spheres_are_led_to_the_end_of_a_triaxial_test(femxdem, tmp_path, b):  # noqa: F811
    """1000 spheres; both lateral stresses, or mean pressure and b, stay where they are led."""
    name, words = ("triaxial", ()) if b is None else ("true-triaxial", ("--b", b))
    result = femxdem(
        "element-test", name, "--packing", DATA / "spheres.h5", "--strain", 3e-3,
        "--accuracy", "fast", "--tolerance", 1e-2, "--output", tmp_path, *words,
    )  # fmt: skip
    assert result.code == 0, result
    table = rows(tmp_path / f"{name}.csv")
    x, y, z = (table[f"stress_{2 * axis}_Pa"] for axis in "xyz")
    assert table["strain_zz"][-1] == pytest.approx(3e-3) and (np.diff(z) > 0)[:5].all()
    good = table["reached"] == 1
    assert good.mean() > 0.7
    led = {None: (x, y), 0.5: ((x + y + z) / 3, y)}[b]
    for component in led:
        assert np.abs(component[good] / 1e5 - 1).max() < 1.5e-2
    ratio = (z / x)[-1]
    angle = np.degrees(np.arcsin((ratio - 1) / (ratio + 1)))
    told = json.loads((tmp_path / f"{name}.json").read_text())
    assert angle - 0.5 < told["peak_friction_angle"] < angle + 8
    assert 20 < told["peak_friction_angle"] < 40


def test_calibration_shows_its_answers_and_tries_other_seeds(femxdem, tmp_path):  # noqa: F811
    preparation = {"grains": 64, "compaction_friction": 0.0}
    laboratory = Laboratory(Target(3e7, 30.0), GUO_ZHAO, 1e5, 0.03, (1, 2), preparation=preparation)
    wanted = laboratory.answer(6e8, 0.5)
    result = femxdem(
        "calibrate", "--grains", 64, "--seeds", 2, "--strain", 0.03, "--output", tmp_path,
        "--threads", 1, "--modulus", 6e8, "--friction", 0.5,
        "--young-modulus", wanted.young_modulus, "--friction-angle", wanted.friction_angle,
    )  # fmt: skip
    assert result.code == 0, result.error
    told = json.loads((tmp_path / "calibration.json").read_text())
    assert told["found"]["young_modulus"] == pytest.approx(wanted.young_modulus, rel=0.051)
    assert told["found"]["friction_angle"] == pytest.approx(wanted.friction_angle, abs=0.51)
    others = replace(laboratory, seeds=(3, 4)).answer(
        told["found"]["modulus"], told["found"]["friction"]
    )
    assert told["other_seeds"]["young_modulus"] == pytest.approx(others.young_modulus, rel=0.05)
    assert "other seeds" in result.out and (tmp_path / "calibration.png").stat().st_size > 5000


def test_a_calibration_without_a_possible_target_is_refused(femxdem, tmp_path):  # noqa: F811
    words = ("calibrate", "--output", tmp_path, "--friction-angle")
    assert_refused(femxdem(*words, 95, "--young-modulus", 3e7), "between 0 and 90")
    assert_refused(femxdem(*words, 30, "--young-modulus", -1), "must be positive")
    assert_refused(femxdem(*words, 30, "--young-modulus", 3e7, "--strain", 0.9), "--strain")
    assert not list(tmp_path.iterdir())


def test_fast_tests_at_constant_volume_are_warned_of(femxdem, sand, tmp_path):  # noqa: F811
    """Their pressure is too high; drained ones and slower ones are none of that."""
    fast, kept = ("--accuracy", "fast"), ("--normal-stress", 1e5)
    short = ("--packing", sand, "--output", tmp_path, "--quiet")
    sheared, cyclic = ("--strain", 1e-3), ("--cycles", 1, "--amplitude", 1e-3)
    for name, words in (
        ("undrained", sheared), ("simple-shear", sheared), ("cyclic-shear", cyclic),
    ):  # fmt: skip
        with pytest.warns(UserWarning, match=f"{name}: at constant volume an inertial number"):
            femxdem("element-test", name, *short, *words, *fast)
    for name, words in (
        ("undrained", sheared), ("biaxial", (*sheared, *fast)),
        ("simple-shear", (*sheared, *fast, *kept)), ("cyclic-shear", (*cyclic, *fast, *kept)),
    ):  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert femxdem("element-test", name, *short, *words).code == 0
