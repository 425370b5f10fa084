"""Friction that varies from element to element."""

import numpy as np
import pytest

from femxdem_fenicsx.variability import Variability


@pytest.mark.parametrize("elements", [8, 9])
def test_half_of_the_elements_are_weaker_and_the_mean_stays(elements):
    friction = Variability(0.1).friction(0.5, elements)
    assert friction.mean() == pytest.approx(0.5)
    lower, higher = np.isclose(friction, 0.4).sum(), np.isclose(friction, 0.6).sum()
    assert lower == higher == elements // 2


def test_the_seed_decides_which_and_nothing_else_does():
    draws = [Variability(0.1, seed=seed).friction(0.5, 60) for seed in (1, 1, 2)]
    assert np.array_equal(draws[0], draws[1])
    assert not np.array_equal(draws[0], draws[2])


def test_one_weak_element_is_the_only_one_that_differs():
    friction = Variability(0.2, weak_element=3).friction(0.5, 6)
    assert friction.tolist() == [0.5, 0.5, 0.5, 0.3, 0.5, 0.5]


@pytest.mark.parametrize(
    ("variability", "complaint"),
    [
        (Variability(0.0), "varies by 0.0"),
        (Variability(0.5), "below the friction coefficient of the grains, 0.5"),
        (Variability(-0.1), "varies by -0.1"),
        (Variability(np.nan), "varies by nan"),
        (Variability(0.1, seed=-1), "variability seed -1: it must be 0 or more"),
        (Variability(0.1, weak_element=6), "elements 0 to 5"),
        (Variability(0.1, weak_element=-1), "weak element -1"),
    ],
)
def test_what_makes_no_friction_is_refused(variability, complaint):
    with pytest.raises(ValueError, match=complaint):
        variability.friction(0.5, 6)
