"""A box that is sheared on and on is replaced by an equivalent one, and nothing jumps."""

import numpy as np
import pytest

from femxdem_fenicsx.dem.accuracy import PRESETS
from femxdem_fenicsx.dem.homogenisation import elastic_energy, stress, touching
from femxdem_fenicsx.dem.packing import PackingBatch, reduction
from femxdem_fenicsx.dem.preparation import random_packing
from femxdem_fenicsx.homogenised_law import HomogenisedLaw

from ..reference import reference_packing


@pytest.mark.parametrize("dim", [2, 3])
def test_reduced_vectors_are_short_and_span_the_same_lattice(dim):
    rng = np.random.default_rng(dim)
    for _ in range(50):
        box = np.eye(dim) + rng.uniform(-5, 5, (dim, dim)) * np.tri(dim, k=-1)
        A = reduction(box)
        np.testing.assert_array_equal(A, A.round())
        assert np.linalg.det(A) == pytest.approx(1.0)
        products = (box @ A).T @ (box @ A)
        squares = np.diag(products).copy()
        np.fill_diagonal(products, 0.0)
        assert (np.abs(products) <= 0.5 * squares * (1 + 1e-9)).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_a_reduction_changes_neither_stress_nor_energy_nor_contacts(dim):
    packing = reference_packing() if dim == 2 else random_packing(200, dim=3, seed=3)
    law = HomogenisedLaw(packing, 1, PRESETS["balanced"])
    law.evaluate((np.eye(dim) + 2e-3 * np.eye(dim, k=1))[None])  # some friction in the contacts
    law.commit()
    sheared = law.packing(0)
    A = np.eye(dim) + 2 * np.eye(dim, k=1)  # the same lattice, seen from a skewed box
    batch = PackingBatch.of(sheared, 1)
    batch.box[0] = sheared.box @ A
    batch.position[0] = np.linalg.inv(A) @ sheared.positions.T
    batch.reduce_boxes()
    reduced = batch.packing(0)
    assert not np.array_equal(batch.turns[0], np.eye(dim))
    scale = np.abs(stress(sheared)).max()
    np.testing.assert_allclose(stress(reduced), stress(sheared), atol=1e-10 * scale)
    assert elastic_energy(reduced) == pytest.approx(elastic_energy(sheared), rel=1e-10)
    assert forces_of(reduced) == forces_of(sheared)


def forces_of(packing) -> dict[tuple[int, int], tuple[float, ...]]:
    contacts = touching(packing)
    forces = contacts.tangential.reshape(len(contacts.pairs), -1)
    return {tuple(p): tuple(f) for p, f in zip(contacts.pairs, forces, strict=True)}


def test_a_packing_is_sheared_by_300_percent_and_stays_a_packing():
    packing = reference_packing()
    law = HomogenisedLaw(packing, 1, PRESETS["fast"])
    step = 0.02
    F = np.array([[[1.0, step], [0.0, 1.0]]])
    pressures = []
    for _ in range(round(3.0 / step)):
        law.evaluate(F)
        law.commit()
        pressures.append(-np.trace(law.stress[0]) / 2)
    np.testing.assert_allclose(law.deformation[0], [[1.0, 3.0], [0.0, 1.0]], atol=1e-9)
    assert not np.array_equal(law.response.committed.turns[0], np.eye(2))
    box = law.response.committed.box[0]
    assert np.abs(box[0] @ box[1]) < np.linalg.det(box)
    assert law.void_ratio[0] == pytest.approx(packing.void_ratio, abs=1e-9)
    # constant volume, dense: the pressure rises to a plateau and stays there, it does not run away
    late = np.array(pressures[len(pressures) // 2 :])
    assert 2e5 < late.mean() < 3e6
    assert late.std() < 0.5 * late.mean()
