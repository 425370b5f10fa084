"""Packings and batches of them: what they accept, and what they give back."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.packing import Packing, PackingBatch

from .scenes import FRICTIONLESS, STIFFNESS, hexagonal, loose

NAN = float("nan")


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"radii": [], "positions": np.zeros((0, 2))}, "no grains"),
        ({"radii": [1e-2, 0.0]}, "radii must be positive"),
        ({"radii": [1e-2, -1e-2]}, "radii must be positive"),
        ({"radii": [1e-2, NAN]}, "radii.*not finite"),
        ({"positions": [[0.1, 0.1], [NAN, 0.5]]}, "positions.*not finite"),
        ({"positions": np.zeros((3, 2))}, "positions has shape"),
        ({"box": np.diag([1.0, -1.0])}, "no positive volume"),
        ({"box": np.diag([1.0, 0.0])}, "no positive volume"),
        ({"box": np.full((2, 2), NAN)}, "box.*not finite"),
        ({"box": np.diag([0.03, 1.0])}, "its own image"),
        ({"box": np.array([[1.0, 40.0], [0.0, 1.0]])}, "its own image"),
        ({"density": 0.0}, "density"),
        ({"density": NAN}, "density"),
        ({"thickness": -1.0}, "thickness"),
        ({"contacts": [[1, 0]], "tangential": [1.0]}, "i < j"),
        ({"contacts": [[0, 2]], "tangential": [1.0]}, "i < j"),
        ({"contacts": [[0, 1]], "tangential": []}, "contacts has shape"),
        ({"contacts": [[0, 1]], "tangential": [NAN]}, "tangential.*not finite"),
    ],
)
def test_what_is_no_packing_is_refused_with_the_reason(changes, complaint):
    good = {
        "box": np.eye(2),
        "positions": [[0.1, 0.1], [0.5, 0.5]],
        "radii": [1e-2, 1e-2],
        "law": FRICTIONLESS,
    }
    assert Packing(**good).size == 2
    with pytest.raises(ValueError, match=complaint) as error:
        Packing(**{**good, **changes})
    assert "\n" not in str(error.value)


def test_a_packing_keeps_its_own_copy_of_what_it_is_given():
    box = np.eye(2)
    packing = Packing(box, np.full((1, 2), 0.5), np.array([0.01]), FRICTIONLESS)
    box[0, 0] = 7.0
    assert packing.box[0, 0] == 1.0


def test_measures_of_a_packing_follow_their_definitions():
    packing = hexagonal()
    assert packing.masses[0] == pytest.approx(2650 * 0.1 * np.pi * 1e-4)
    assert packing.volume == pytest.approx(np.linalg.det(packing.box) * 0.1)
    assert packing.mean_diameter == pytest.approx(2e-2)
    turned = packing.deformed(np.array([[0.0, -1.0], [1.0, 0.0]]))
    assert turned.void_ratio == pytest.approx(packing.void_ratio)


def with_friction(seed: int) -> Packing:
    law = LinearContact(stiffness=STIFFNESS, friction=0.5)
    packing = loose(50, 1, np.eye(2) * 0.1, law)
    rng = np.random.default_rng(seed)
    i, j = np.triu_indices(50, 1)
    chosen = rng.permutation(len(i))[:70]  # in no order
    return packing.but(
        contacts=np.column_stack([i[chosen], j[chosen]]), tangential=rng.normal(size=70)
    )


def test_a_batch_gives_back_what_was_put_into_it():
    packings = [with_friction(seed) for seed in range(3)]
    batch = PackingBatch.of(packings[0], 3)
    for b, packing in enumerate(packings):
        batch.put(b, packing)
    copy = batch.copy()
    batch.put(0, packings[2])
    for b, packing in enumerate(packings):
        back = copy.packing(b)
        for name in ("box", "positions", "radii"):
            np.testing.assert_array_equal(getattr(back, name), getattr(packing, name))
        expected = dict(zip(map(tuple, packing.contacts), packing.tangential, strict=True))
        assert dict(zip(map(tuple, back.contacts), back.tangential, strict=True)) == expected
        assert back.law == packing.law


def test_a_batch_takes_only_its_own_grains_and_a_size_that_exists():
    packing = with_friction(0)
    batch = PackingBatch.of(packing, 1)
    with pytest.raises(ValueError, match="same grains"):
        batch.put(0, packing.but(radii=packing.radii[::-1]))
    with pytest.raises(ValueError, match="size"):
        PackingBatch.of(packing, -1)
    assert PackingBatch.of(packing, 0).size == 0
