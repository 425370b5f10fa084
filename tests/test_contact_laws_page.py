"""The law that docs/contact-laws.md adds, taken from the page and run."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from femxdem_fenicsx.dem.files import load_packing, save_packing
from femxdem_fenicsx.dem.homogenisation import (
    coordination_number,
    elastic_energy,
    elastic_response,
    stress,
    touching,
)
from femxdem_fenicsx.dem.preparation import settle

PAGE = Path(__file__).parents[1] / "docs" / "contact-laws.md"


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """(the module `conical`, the packing that the page prepares)."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (law,) = (block for block in blocks if block.startswith("# conical.py"))
    (usage,) = (block for block in blocks if "from conical import" in block)
    folder = tmp_path_factory.mktemp("mine")
    (folder / "conical.py").write_text(law)
    sys.path.insert(0, str(folder))
    try:
        scope = {}
        exec(usage, scope)
        yield importlib.import_module("conical"), scope["packing"]
    finally:
        sys.path.remove(str(folder))


def test_the_forces_are_the_formula_and_the_stiffness_is_their_derivative(example):
    conical, _ = example
    law = conical.ConicalContact(modulus=1e9, angle=0.2).elasticity
    coefficient = law.coefficient(4e-3, 6e-3)
    overlaps = 1e-5 * (1.0 + 1e-4 * np.array([-1.0, 0.0, 1.0]))
    forces, k_n, _ = elastic_response(law, np.full(3, coefficient), overlaps)
    assert forces[1] == pytest.approx(2 / np.pi * 1e9 * 1e-10 / np.tan(0.2))
    assert k_n[1] == pytest.approx((forces[2] - forces[0]) / (overlaps[2] - overlaps[0]))


def test_the_packing_of_the_page_is_at_rest_under_its_pressure_and_stores_the_work(example):
    _, packing = example
    np.testing.assert_allclose(stress(packing), -1e5 * np.eye(2), atol=1e2)
    contacts = touching(packing)
    expected = (contacts.stiffness * contacts.overlaps**2).sum() / 6  # c u^3 / 3
    assert elastic_energy(packing) == pytest.approx(expected)


def test_its_stiffness_grows_with_the_square_root_of_pressure(example):
    _, packing = example
    pressed = settle(packing, 4e5)

    def scaled(packing):
        contacts = touching(packing)
        springs = (contacts.stiffness * (contacts.branches**2).sum(1)).sum() / packing.volume
        return springs / (coordination_number(packing) / (1.0 + packing.void_ratio)) ** 0.5

    assert scaled(pressed) / scaled(packing) == pytest.approx(2.0, rel=0.08)


def test_a_file_with_it_is_read_where_the_law_is_known(example, tmp_path):
    _, packing = example
    save_packing(tmp_path / "cones.h5", packing)
    assert load_packing(tmp_path / "cones.h5").law == packing.law
