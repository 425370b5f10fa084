"""Random packings brought to a pressure."""

import numpy as np
import pytest

from femxdem_fenicsx.dem import preparation
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.grain_sizes import SieveCurve
from femxdem_fenicsx.dem.homogenisation import coordination_number, stress, touching
from femxdem_fenicsx.dem.packing import PackingBatch
from femxdem_fenicsx.dem.preparation import (
    DENSITIES,
    NotReached,
    library,
    packing_of_void_ratio,
    random_packing,
)

PRESSURE = 1e5


@pytest.fixture(scope="module")
def dense():
    return random_packing()


def unbalance(packing) -> float:
    contacts = touching(packing)
    net = np.zeros((packing.size, 2))
    np.add.at(net, contacts.pairs[:, 0], contacts.forces)
    np.subtract.at(net, contacts.pairs[:, 1], contacts.forces)
    return np.linalg.norm(net, axis=1).max() / np.linalg.norm(contacts.forces, axis=1).max()


def test_400_disks_at_100_kpa_are_as_dense_as_in_the_papers(dense):
    assert dense.size == 400
    assert dense.radii.min() >= 3e-3 and dense.radii.max() <= 7e-3
    np.testing.assert_allclose(stress(dense), -PRESSURE * np.eye(2), atol=1e-3 * PRESSURE)
    assert unbalance(dense) < 2e-3
    assert 0.165 < dense.void_ratio < 0.185  # Guo-Zhao: 0.177
    assert 4.05 < coordination_number(dense) < 4.3
    assert dense.law.friction == pytest.approx(np.tan(0.5))  # although compressed without
    assert ((dense.positions >= 0) & (dense.positions < 1)).all()


def test_friction_during_the_compression_makes_it_looser(dense):
    voids = [dense.void_ratio]
    for friction in (0.1, 0.3):
        packing = random_packing(compaction_friction=friction)
        np.testing.assert_allclose(stress(packing), -PRESSURE * np.eye(2), atol=1e-3 * PRESSURE)
        voids.append(packing.void_ratio)
        assert packing.law == dense.law
    assert voids[0] + 0.01 < voids[1] < voids[2] - 0.005
    assert voids[2] < 0.30


def test_the_same_seed_gives_the_same_bits_and_another_seed_another_packing():
    first, again, other = (random_packing(64, seed=seed) for seed in (7, 7, 8))
    for name in ("box", "positions", "radii", "contacts", "tangential"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.radii, other.radii)
    assert not np.array_equal(first.positions, other.positions)


def test_a_bumpy_request_is_met_too():
    law = LinearContact(stiffness=3e6, friction=0.3, cohesion=5.0, viscous_damping=0.1)
    packing = random_packing(
        100, (2e-3, 2e-3), law, pressure=3e4, compaction_friction=0.2, density=2000, thickness=1.0
    )
    np.testing.assert_allclose(stress(packing), -3e4 * np.eye(2), atol=3e1)
    assert (packing.radii == 2e-3).all()
    assert packing.law == law
    assert (packing.density, packing.thickness) == (2000, 1.0)


def test_progress_is_told_on_the_way_to_the_pressure():
    told = []
    random_packing(36, progress=told.append)
    assert told[0] < 0.5
    assert told[-1] == pytest.approx(1, abs=0.5)


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"grains": 0}, "1 grain or more"),
        ({"grains": -5}, "1 grain or more"),
        ({"grains": 1}, "use more grains"),
        ({"radii": (7e-3, 3e-3)}, "radii"),
        ({"radii": (0.0, 3e-3)}, "radii"),
        ({"radii": (-1e-3, 3e-3)}, "radii"),
        ({"radii": (float("nan"), 3e-3)}, "radii"),
        ({"pressure": -1e5}, "pressure"),
        ({"pressure": 0.0}, "pressure"),
        ({"pressure": float("nan")}, "pressure"),
        ({"compaction_friction": -0.1}, "friction"),
        ({"density": -1.0}, "density"),
        ({"seed": -1}, "a seed must be 0 or more, got -1"),
    ],
)
def test_what_makes_no_packing_is_refused_with_the_reason(values, complaint):
    with pytest.raises(ValueError, match=complaint) as error:
        random_packing(**values)
    assert "\n" not in str(error.value)


def test_a_pressure_that_is_not_reached_is_an_error_that_says_how_far_it_came(monkeypatch):
    monkeypatch.setattr(preparation, "MOST_BLOCKS", 3)
    with pytest.raises(RuntimeError, match=r"of 1e\+05 Pa.*after 75 steps"):
        random_packing(36)


def test_friction_during_compaction_is_found_for_a_void_ratio():
    packing = packing_of_void_ratio(0.209, grains=400, seed=1)
    assert packing.void_ratio == pytest.approx(0.209, abs=2e-3)
    np.testing.assert_allclose(np.diag(stress(packing)), -1e5, rtol=1.1e-3)


def test_a_void_ratio_out_of_reach_is_refused_with_what_was_reached():
    with pytest.raises(RuntimeError, match=r"void ratio 0.5 was not reached.*0\.\d+ to 0\.\d+"):
        packing_of_void_ratio(0.5, grains=100)


def test_unequal_stresses_are_reached_axis_by_axis():
    packing = random_packing(400, pressure=(1e5, 1.3e5))
    np.testing.assert_allclose(stress(packing), -np.diag([1e5, 1.3e5]), atol=2e2)


@pytest.mark.parametrize("pressure", [-1e5, 0.0, np.nan, (1e5, -1.0), (1e5, 1e5, 1e5)])
def test_a_pressure_that_is_none_is_refused(pressure):
    with pytest.raises(ValueError, match="pressure"):
        random_packing(100, pressure=pressure)


def test_a_sieve_curve_gives_the_sizes_of_a_packing():
    curve = SieveCurve((6e-3, 8e-3, 14e-3), (0.0, 0.4, 1.0))
    packing = random_packing(100, curve, seed=2)
    np.testing.assert_allclose(np.diag(stress(packing)), -1e5, rtol=1.1e-3)
    volume = packing.grain_volumes
    assert volume[packing.radii < 4e-3].sum() / volume.sum() == pytest.approx(0.4, abs=0.04)


def test_density_classes_come_in_their_order():
    """Means of four packings: one scatters by 0.01."""
    assert DENSITIES["dense"] == 0.0
    dense, medium, loose = (
        np.mean([
            random_packing(compaction_friction=friction, seed=seed).void_ratio
            for seed in range(1, 5)
        ])
        for friction in DENSITIES.values()
    )  # fmt: skip
    assert dense + 0.01 < medium < loose - 0.01
    assert 0.16 < dense < 0.19 and 0.19 < medium < 0.22 and 0.21 < loose < 0.245


def test_a_library_is_one_set_of_grains_at_different_places():
    first, second, third = library(3, seed=5, grains=64)
    batch = PackingBatch.of(first, 3)
    for b, packing in enumerate((first, second, third)):
        np.testing.assert_array_equal(packing.radii, first.radii)
        np.testing.assert_allclose(np.diag(stress(packing)), -1e5, rtol=1.1e-3)
        batch.put(b, packing)
    assert len({packing.void_ratio for packing in (first, second, third)}) == 3
    with pytest.raises(ValueError, match="1 packing or more"):
        next(library(0))


def test_stresses_that_grains_cannot_bear_end_with_the_state_that_was_reached():
    with pytest.raises(NotReached, match="flattened: the grains cannot bear") as error:
        random_packing(64, pressure=(1e5, 2e6))
    assert error.value.packing.size == 64
    assert error.value.packing.box[1, 1] < error.value.packing.box[0, 0]
    assert "\n" not in str(error.value)


def test_a_void_ratio_out_of_reach_keeps_the_packing_that_came_closest():
    with pytest.raises(NotReached) as error:
        packing_of_void_ratio(0.1, grains=64)
    kept = error.value.packing
    assert kept.void_ratio < 0.2 and f"{kept.void_ratio:.4f} at best" in str(error.value)
    with pytest.raises(ValueError, match="void ratio"):
        packing_of_void_ratio(float("nan"))
