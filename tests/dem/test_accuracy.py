"""What a user may ask of the accuracy, and what not."""

import math
import warnings

import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS, Accuracy, preset, warn_of_rate


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"time_step": 1.1}, "above the stability limit"),
        ({"time_step": 0.0}, "time_step"),
        ({"time_step": math.nan}, "time_step"),
        ({"inertial_number": 0.0}, "inertial_number"),
        ({"inertial_number": -1e-3}, "inertial_number"),
        ({"inertial_number": math.nan}, "inertial_number"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"hold_limit": 0}, "hold_limit"),
        ({"damping": 1.0}, "damping"),
        ({"hold_damping": -0.1}, "hold_damping"),
    ],
)
def test_settings_that_cannot_work_are_refused_by_name(values, complaint):
    with pytest.raises(ValueError, match=complaint):
        Accuracy(**values)
    with pytest.raises(ValueError, match=complaint):
        PRESETS["fast"].but(**values)


def test_an_unknown_preset_is_answered_with_the_known_ones():
    with pytest.raises(ValueError, match=r"'exact'.*fast, balanced, reference"):
        preset("exact")
    assert preset("balanced") is PRESETS["balanced"]


def test_a_preset_with_changes_is_a_copy_and_unknown_settings_are_named():
    changed = PRESETS["fast"].but(tolerance=1e-4)
    assert changed.tolerance == 1e-4
    assert PRESETS["fast"].tolerance == preset("fast").tolerance == 3e-2
    with pytest.raises(ValueError, match="patience"):
        PRESETS["fast"].but(patience=3)


def test_the_reference_preset_has_the_settings_of_desrues():
    assert (PRESETS["reference"].inertial_number, PRESETS["reference"].tolerance) == (1e-4, 1e-3)


def test_rates_above_that_of_balanced_are_warned_of_in_one_line():
    with pytest.warns(UserWarning, match="undrained: at constant volume") as caught:
        warn_of_rate(PRESETS["fast"], "undrained")
    assert len(caught) == 1 and "\n" not in str(caught[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in ("balanced", "reference"):
            warn_of_rate(PRESETS[name], "undrained")
