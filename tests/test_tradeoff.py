"""Speed for accuracy: the study on a small packing, and how its errors are counted."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from femxdem_fenicsx import tradeoff
from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.contacts import Bonds, LinearContact, RollingResistance
from femxdem_fenicsx.dem.files import save_packing
from femxdem_fenicsx.dem.preparation import random_packing
from femxdem_fenicsx.homogenised_law import HomogenisedLaw
from femxdem_fenicsx.tradeoff import Answer, Case, Path

from .commands.lab import assert_refused, femxdem  # noqa: F401

SHORT = Path(increments=2, directions=2, drained=2e-3)


@pytest.fixture(scope="module")
def packing():
    return random_packing(64)


def answer(stress, steps=100.0) -> Answer:
    curve = np.array([[1e-3, 1.1, 0.2], [2e-3, 1.3, 0.21]])
    return Answer(np.asarray(stress, float), curve, steps, 1e-3)


def test_a_path_compresses_in_all_directions_and_turns_in_every_other_one():
    for dim in (2, 3):
        F = Path(directions=4).F(dim) - np.eye(dim)
        np.testing.assert_allclose(np.trace(F, axis1=1, axis2=2), -2e-4, atol=1e-12)
        symmetric = 0.5 * (F + np.swapaxes(F, 1, 2))
        np.testing.assert_allclose(np.linalg.eigvalsh(symmetric)[:, 0], -1e-3)
        turns = np.abs(F - symmetric).max((1, 2))
        np.testing.assert_allclose(turns, [0, 5e-4, 0, 5e-4], atol=1e-12)
        np.testing.assert_allclose(F[0, -1, -1], -1e-3)
    with pytest.raises(ValueError, match="strain path: need 1 or more"):
        Path(increments=0)
    for lateral in (np.nan, 1e9, -np.inf):
        with pytest.raises(ValueError, match="strain path: a lateral extension of"):
            Path(lateral=lateral)


def test_errors_are_root_mean_squares_over_the_mean_principal_stress():
    reference = answer(np.tile(-1e5 * np.eye(2), (2, 3, 4, 1, 1)))
    off = np.array([1e3, 3e3])[:, None, None, None, None] * np.ones((2, 3, 4, 2, 2))
    row = tradeoff.figures(
        Case("a", "b", PRESETS["fast"]), answer(reference.stress + off, 50.0), reference
    )
    assert row["rms_stress_error"] == pytest.approx(np.sqrt((0.01**2 + 0.03**2) / 2))
    assert row["spread_over_packings"] == pytest.approx(0.02 / np.sqrt(2))
    assert (row["dem_steps"], row["curve_error"], row["void_ratio_error"]) == (50.0, 0.0, 0.0)


def test_scatter_is_the_standard_deviation_between_packings():
    stress = -1e5 * np.eye(2) + np.random.default_rng(0).normal(0, 2e3, (400, 1, 1, 2, 2))
    assert tradeoff.scatter(answer(stress)) == pytest.approx(0.02, rel=0.1)
    assert tradeoff.scatter(answer(stress[:1])) == 0.0


def test_other_grains_are_compared_with_the_mean_of_the_packings_and_the_curve_with_the_first():
    stress = -1e5 * np.eye(2) * np.array([0.9, 1.1])[:, None, None, None, None]
    reference = answer(np.tile(stress, (1, 3, 4, 1, 1)))
    like_the_mean = answer(np.tile(-1e5 * np.eye(2), (2, 3, 4, 1, 1)))
    others = Case("grains per packing", "9", PRESETS["fast"], lambda p: p, other_grains=True)
    assert tradeoff.figures(others, like_the_mean, reference)["rms_stress_error"] < 1e-12
    same = replace(others, other_grains=False)
    row = tradeoff.figures(same, like_the_mean, reference)
    assert row["rms_stress_error"] == pytest.approx(0.1 / np.sqrt(2))  # half the components are 0
    assert not row["same_model"]
    assert tradeoff.scatter(reference) == pytest.approx(0.1)


def test_errors_of_the_drained_curve_are_of_its_peak_its_end_and_its_void_ratio():
    stress = np.tile(-1e5 * np.eye(2), (1, 1, 1, 1, 1))
    curve = np.array([[1e-3, 1.2, 0.2], [2e-3, 1.5, 0.21], [3e-3, 1.4, 0.22]])
    ours = np.array([[1e-3, 1.2, 0.2], [2e-3, 1.65, 0.214]])  # it ended earlier
    row = tradeoff.figures(
        Case("time step", "1", PRESETS["fast"]),
        Answer(stress, ours, 1.0, 1.0), Answer(stress, curve, 1.0, 1.0),
    )  # fmt: skip
    assert row["peak_error"] == pytest.approx(0.1)
    assert row["last_error"] == pytest.approx(0.15 / 1.5)
    assert row["void_ratio_error"] == pytest.approx(0.004)
    assert row["curve_error"] == pytest.approx(np.sqrt(0.15**2 / 2) / curve[:, 1].mean())
    assert row["same_model"]


def rows_of(setting: str, *values: tuple, same_model: bool = True) -> list[dict]:
    names = ("value", "dem_steps", "rms_stress_error", "seconds", "curve_error")
    return [
        {"setting": setting, "same_model": same_model, **dict(zip(names, v, strict=True))}
        for v in values
    ]


def test_a_sentence_goes_from_the_costly_value_to_the_cheap_one_and_weighs_its_error():
    rows = [
        *rows_of("rate", ("1", 50, 0.04, 9.0, 0.5), ("2", 200, 0.01, 1.0, 0.5),
                 ("3", 100, 0.02, 1.0, 0.5)),
        *rows_of("alone", ("1", 50, 0.04, 9.0, 0.5)),
        *rows_of("model", ("soft", 9, 0.0, 1.0, 0.25), ("hard", 1, 0.0, 3.0, 0.0),
                 same_model=False),
    ]  # fmt: skip
    rate, model = tradeoff.sentences(rows, 0.03)
    assert rate == (
        "rate from 2 to 1: 4 times faster, 4.0% error (1.0% before), more than the scatter between"
        " packings (3.0%)"
    )
    assert model.startswith("model from hard to soft: 3 times faster, 25.0% error (0.0% before), m")
    assert "less than the scatter" in tradeoff.sentences(rows, 0.05)[0]
    by_curve = tradeoff.sentences(rows, 0.03, "curve_error")[0]
    assert by_curve.startswith("rate from 2 to 1: 4 times faster, 50.0% error (50.0% before)")


@pytest.mark.parametrize("quick", [True, False])
def test_the_sweep_changes_one_setting_of_the_default_at_a_time(quick):
    changed = {
        "inertial number": {"inertial_number"},
        "equilibrium tolerance": {"tolerance", "hold_limit"},
        "time step": {"time_step"},
        "damping while loading": {"damping"},
        "damping while held": {"hold_damping"},
        "start of an increment": set(),
    }
    base, found = asdict(PRESETS["balanced"]), {}
    for case in tradeoff.settings(quick):
        if case.setting == "preset":
            assert case.accuracy == PRESETS[case.value]
            continue
        differs = {name for name, value in asdict(case.accuracy).items() if value != base[name]}
        assert differs <= changed[case.setting]
        found.setdefault(case.setting, []).append(case)
        if differs:
            name = (differs - {"hold_limit"} or differs).pop()
            assert case.value in ("0.01", f"{getattr(case.accuracy, name):g}")
    assert set(found) == set(changed)
    assert all(len({case.value for case in cases}) > 1 for cases in found.values())
    laws = {case.value: case.law for case in found["start of an increment"]}
    assert laws["rest"] is tradeoff.FromRest is not laws["flow"]


def test_each_contact_feature_is_switched_on_or_off():
    law = LinearContact(modulus=6e8, friction=0.4)
    off, on = tradeoff.switched(law).items()
    assert off == ("without friction", replace(law, friction=0.0))
    assert on == ("with rolling resistance", replace(law, rolling=RollingResistance(0.1)))
    smooth = replace(law, friction=0.0)
    assert tradeoff.switched(smooth) == {"with friction": replace(law, friction=0.5)}
    parts = {"bonds": Bonds(1.0, 1.0), "rolling": RollingResistance(0.2)}
    full = replace(law, cohesion=1.0, viscous_damping=0.1, **parts)
    switched = tradeoff.switched(full)
    assert switched["without friction"] == replace(full, friction=0.0, bonds=None, rolling=None)
    for name, nothing in (
        ("cohesion", 0.0), ("viscous damping", 0.0), ("bonds", None), ("rolling resistance", None),
    ):  # fmt: skip
        attribute = name.replace(" ", "_").removesuffix("_resistance")
        assert switched[f"without {name}"] == replace(full, **{attribute: nothing})
    assert len(switched) == 5


def test_other_models_of_the_packing_are_stiffer_softer_and_of_fewer_grains(packing):
    cases = list(tradeoff.physics([packing], quick=True))
    level = {case.value: case for case in cases if case.setting == "stiffness level"}
    assert len(level) == 3
    for value, case in level.items():
        changed = case.change(packing)
        assert changed.stiffness_level(1e5) == pytest.approx(float(value), rel=1e-2)
        assert -np.trace(HomogenisedLaw(changed, 1).stress[0]) / 2 == pytest.approx(1e5, rel=0.02)
    fewer = [case for case in cases if case.setting == "grains per packing"][-1]
    few = fewer.change(packing)
    assert few.size == int(fewer.value) and fewer.other_grains
    assert few.radii.min() >= packing.radii.min() and few.radii.max() <= packing.radii.max()
    contacts = [case for case in cases if case.setting == "contacts"]
    assert [case.value for case in contacts] == ["as given", *tradeoff.switched(packing.law)]
    assert contacts[1].change(packing).law.friction == 0.0
    assert contacts[2].change(packing).law.rolling is not None


def test_a_family_is_the_packing_and_others_of_the_same_grains_under_the_same_pressure(packing):
    first, *others = tradeoff.family(packing, 3)
    assert first is packing and len(others) == 2
    for other in others:
        assert not np.array_equal(other.positions, packing.positions)
        np.testing.assert_array_equal(np.sort(other.radii), np.sort(packing.radii))
        assert -np.trace(HomogenisedLaw(other, 1).stress[0]) / 2 == pytest.approx(1e5, rel=0.02)
    assert tradeoff.family(packing, 1) == [packing]


def test_increments_from_rest_forget_how_the_grains_moved(packing):
    flows = []
    for law in (tradeoff.FromRest, HomogenisedLaw):
        one = law(packing, 1, PRESETS["fast"])
        one.evaluate(np.diag([1.0008, 0.999])[None])
        one.commit()
        flows.append(np.abs(one.response.committed.flow).max())
    assert flows[0] == 0 < flows[1]


def test_a_run_leads_each_packing_along_the_path_and_counts_steps_per_increment(packing):
    law, stresses = HomogenisedLaw(packing, 2, PRESETS["fast"]), []
    for _ in range(2):
        stresses.append(law.evaluate(SHORT.F(2)))
        law.commit()
    found = tradeoff.run([packing, packing], SHORT, PRESETS["fast"])
    np.testing.assert_array_equal(found.stress, [stresses, stresses])
    assert found.steps == law.tally.steps / (2 * 2)
    np.testing.assert_allclose(found.drained[:, 0], [1e-3, 2e-3])


def test_slower_runs_are_nearer_to_a_very_slow_one_and_cost_more(packing):
    slow = tradeoff.run([packing], SHORT, PRESETS["reference"].but(inertial_number=2e-5))
    rows = [
        tradeoff.figures(Case("preset", name, PRESETS[name]),
                         tradeoff.run([packing], SHORT, PRESETS[name]), slow)
        for name in ("fast", "reference")
    ]  # fmt: skip
    assert rows[0]["dem_steps"] * 3 < rows[1]["dem_steps"] < slow.steps
    assert rows[1]["rms_stress_error"] < rows[0]["rms_stress_error"] < 0.1
    again = tradeoff.run([packing], SHORT, PRESETS["fast"])
    assert again.steps == rows[0]["dem_steps"]  # noise-free


def test_the_command_writes_table_picture_and_summary(femxdem, packing, tmp_path, monkeypatch):  # noqa: F811
    monkeypatch.setattr(tradeoff, "SLOWEST", PRESETS["reference"].but(hold_limit=200_000))
    save_packing(tmp_path / "packing.h5", packing)
    shown = femxdem(
        "tradeoff", "--packing", tmp_path / "packing.h5", "--quick", "--increments", 2,
        "--directions", 1, "--packings", 2, "--void-ratio", 0.2, "--critical-packings", 2,
        "--output", tmp_path,
    )  # fmt: skip
    assert shown.code == 0, shown.error
    result = json.loads((tmp_path / "tradeoff.json").read_text())
    assert set(result["presets"]) == set(PRESETS)
    for row in result["presets"].values():
        assert {"rms_stress_error", "dem_steps", "speedup_against_reference"} <= set(row)
    assert result["presets"]["reference"]["speedup_against_reference"] == 1.0
    assert result["presets"]["fast"]["speedup_against_reference"] > 3
    lines = (tmp_path / "tradeoff.csv").read_text().splitlines()
    assert len(lines) == 1 + len(result["sweep"])
    critical = result["critical"]
    assert (critical["packings"], critical["void_ratio"]) == (2, 0.2)
    for row in critical["rows"]:
        assert row["pressure_Pa"] > 0 and f"{row['dem_steps']:.0f}" in shown.out
    costs = [row["dem_steps"] for row in critical["rows"]]
    assert [row["accuracy"] for row in critical["rows"]] == list(PRESETS) and costs == sorted(costs)
    assert len((tmp_path / "critical.csv").read_text().splitlines()) == 1 + len(PRESETS)
    assert (tmp_path / "tradeoff.png").stat().st_size > 10_000
    for setting in {row["setting"] for row in result["sweep"]}:
        (sentence,) = (s for s in result["sentences"] if s.startswith(f"{setting} from "))
        assert sentence in shown.out and " times faster, " in sentence


def test_what_cannot_be_studied_is_refused(femxdem, packing, tmp_path):  # noqa: F811
    save_packing(tmp_path / "packing.h5", packing)
    command = ("tradeoff", "--packing", tmp_path / "packing.h5", "--output", tmp_path)
    assert_refused(femxdem(*command, "--packings", 0), "--packings must be 1 or more")
    refused = femxdem(*command, "--critical-packings", 1)
    assert_refused(refused, "--critical-packings must be 2 or more")
    assert_refused(femxdem(*command, "--void-ratio", -1), "need a positive void ratio, got -1")
    assert_refused(femxdem(*command, "--increments", 0), "strain path: need 1 or more")
    apart = replace(packing, box=1.5 * packing.box, contacts=np.zeros((0, 2)), tangential=[])
    save_packing(tmp_path / "apart.h5", apart)
    refused = femxdem("tradeoff", "--packing", tmp_path / "apart.h5", "--output", tmp_path)
    assert_refused(refused, "the packing bears no pressure")
