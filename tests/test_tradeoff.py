"""Speed for accuracy: the study on a small packing, and how its errors are counted."""

import json
from dataclasses import replace

import numpy as np
import pytest

from femxdem_fenicsx import tradeoff
from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.files import save_packing
from femxdem_fenicsx.dem.preparation import random_packing
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
        "--directions", 1, "--packings", 2, "--output", tmp_path,
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
    assert (tmp_path / "tradeoff.png").stat().st_size > 10_000
    for setting in {row["setting"] for row in result["sweep"]}:
        (sentence,) = (s for s in result["sentences"] if s.startswith(f"{setting} from "))
        assert sentence in shown.out and " times faster, " in sentence


def test_what_cannot_be_studied_is_refused(femxdem, packing, tmp_path):  # noqa: F811
    save_packing(tmp_path / "packing.h5", packing)
    command = ("tradeoff", "--packing", tmp_path / "packing.h5", "--output", tmp_path)
    assert_refused(femxdem(*command, "--packings", 0), "--packings must be 1 or more")
    assert_refused(femxdem(*command, "--increments", 0), "strain path: need 1 or more")
    apart = replace(packing, box=1.5 * packing.box, contacts=np.zeros((0, 2)), tangential=[])
    save_packing(tmp_path / "apart.h5", apart)
    refused = femxdem("tradeoff", "--packing", tmp_path / "apart.h5", "--output", tmp_path)
    assert_refused(refused, "the packing bears no pressure")
