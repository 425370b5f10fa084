"""What a user reads: the help of options."""

import argparse

import pytest

from demos import biaxial, triaxial
from femxdem_fenicsx.terminal import HelpFormatter


def test_the_help_shows_defaults_as_they_would_be_typed():
    parser = argparse.ArgumentParser(formatter_class=HelpFormatter)
    parser.add_argument("--radii", default=(0.003, 0.007), help="m")
    parser.add_argument("--points", help="quadrature  (default: the element's)")
    parser.add_argument("--seed", default=1, help="which packing")
    words = parser.format_help()
    assert "m (default: 0.003 0.007)" in words
    assert "which packing (default: 1)" in words
    assert "None" not in words


@pytest.mark.parametrize("demo", [biaxial, triaxial])
def test_every_option_of_a_demo_says_what_it_is(demo):
    assert [action.option_strings for action in demo.arguments()._actions if not action.help] == []
