"""The Verlet pair list against a search over everything."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from femxdem_fenicsx.dem import neighbours
from femxdem_fenicsx.dem.contacts import LinearContact

from .scenes import Moving, loose, pairs_closer_than_reach_plus, started, two_grains

ROTATED = np.array([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]])
BOXES = {
    "square": (300, np.eye(2) * 0.2),
    "oblong": (300, np.diag([0.6, 0.06])),
    "skewed by 45 degrees": (300, 0.2 * np.array([[1.0, 1.0], [0.0, 1.0]])),
    "skewed to a needle": (200, 0.2 * np.array([[1.0, 2.5], [0.0, 1.0]])),
    "skewed the other way": (200, 0.2 * np.array([[1.0, 0.0], [-1.7, 1.0]])),
    "rotated and skewed": (300, ROTATED @ (0.2 * np.array([[1.0, -0.8], [0.3, 1.0]]))),
    "fewer than 3 grid squares": (8, np.eye(2) * 0.035),
    "fewer than 3 grid squares one way": (40, np.diag([0.035, 0.2])),
    "few and skewed": (12, 0.04 * np.array([[1.0, 0.5], [0.0, 1.0]])),
    "two grains": (2, np.eye(2) * 0.1),
}


def listed_with_shifts(moving: Moving) -> dict:
    pairs = moving.work.pairs
    return {pair: tuple(pairs.shift[:, c]) for pair, c in moving.listed().items()}


@pytest.mark.parametrize("case", BOXES)
@pytest.mark.parametrize("seed", range(3))
def test_the_list_holds_exactly_the_pairs_that_a_brute_force_search_finds(case, seed):
    grains, box = BOXES[case]
    moving = Moving(loose(grains, seed, box))
    expected = pairs_closer_than_reach_plus(
        moving.material.skin, box, moving.packing.positions, moving.packing.radii
    )
    assert expected or grains == 2
    assert listed_with_shifts(moving) == expected
    pairs, radii = moving.work.pairs, moving.packing.radii
    for (i, j), c in moving.listed().items():
        assert pairs.first[i] <= c < pairs.first[i + 1]
        assert pairs.reach[c] == radii[i] + radii[j]


def test_a_list_without_room_says_so():
    packing = loose(100, 0, np.eye(2) * 0.05)
    pairs, _, grid = neighbours.allocate(packing.size, 2, 5, False)
    material = packing.material
    count = neighbours.build(
        packing.box, packing.positions.T.copy(), packing.radii, material.inverse_mass,
        material.law, None, material.skin, pairs, grid,
    )  # fmt: skip
    assert count == -1


def test_stiffness_and_dashpot_of_a_pair_follow_the_contact_law():
    law = LinearContact(modulus=2e7, viscous_damping=0.3)
    packing = two_grains(0.0, law, radii=(4e-3, 9e-3))
    pairs, masses = Moving(packing).work.pairs, packing.masses
    stiffness = 2e7 * 2 * 4e-3 * 9e-3 / 13e-3  # Guo-Zhao eq. 14
    reduced = masses[0] * masses[1] / masses.sum()
    assert pairs.coefficient[0] == pytest.approx(stiffness)
    assert pairs.dashpot[0] == pytest.approx(2 * 0.3 * np.sqrt(reduced))  # times sqrt(k_n)


def test_tangential_forces_survive_a_rebuild_and_those_of_parted_pairs_do_not():
    moving = Moving(loose(200, 4, np.eye(2) * 0.15, LinearContact(stiffness=1e5)))
    work = moving.work
    rng = np.random.default_rng(1)
    before = {pair: rng.normal() for pair in moving.listed()}
    for pair, c in moving.listed().items():
        work.pairs.tangential[0, c] = before[pair]
    neighbours.remember(work.pairs, work.history)
    # grains wander into other grid squares, over the box's edges and away from each other
    work.motion.position[:] += 5e-3 * rng.normal(size=work.motion.position.shape) + 0.4
    assert started(moving.material, work)
    after = moving.listed()
    assert set(before) - set(after) and set(after) - set(before) and set(after) & set(before)
    for pair, c in after.items():
        assert work.pairs.tangential[0, c] == before.get(pair, 0.0)


def used_up(moving: Moving, box, position) -> float:
    longest = 2.0 * moving.packing.radii.max()
    return neighbours.outdated(box, position, longest, moving.material.skin, moving.work.pairs)


@settings(max_examples=100, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    grains_move=st.floats(0, 1),
    box_moves=st.floats(0, 1),
    skew=st.floats(-1.5, 1.5),
)
def test_no_unlisted_pair_touches_while_the_skin_is_not_used_up(seed, grains_move, box_moves, skew):
    box = 0.07 * np.array([[1.0, skew], [0.0, 1.0]])
    moving = Moving(loose(30, seed, box))
    rng = np.random.default_rng(seed + 1)
    anchor = moving.work.motion.position.copy()
    wander = grains_move * rng.uniform(-1, 1, anchor.shape)
    strain = box_moves * rng.uniform(-1, 1, (2, 2))

    def state(share):
        return (np.eye(2) + share * strain) @ box, anchor + share * wander

    low, high = 0.0, 0.1
    for _ in range(25):  # as far as the bound allows
        middle = 0.5 * (low + high)
        low, high = (middle, high) if used_up(moving, *state(middle)) < 1 else (low, middle)
    new_box, position = state(low)
    touching = pairs_closer_than_reach_plus(0.0, new_box, position.T, moving.packing.radii)
    assert set(touching) <= set(moving.listed())


def test_two_grains_that_rush_at_each_other_use_up_the_skin_just_before_they_touch():
    skin = two_grains(0.0).material.skin
    moving = Moving(two_grains(1.001 * skin, angle=0.7))
    assert not moving.listed()
    box, anchor = moving.packing.box, moving.work.motion.position.copy()
    branch = anchor[:, 1] - anchor[:, 0]
    closing = 0.5 * 1.001 * skin / np.linalg.norm(box @ branch) * branch  # each grain by half
    towards = np.column_stack([closing, -closing])
    assert used_up(moving, box, anchor + 0.99 * towards) < 1
    assert used_up(moving, box, anchor + towards) >= 1


def test_a_box_that_shrinks_uses_up_the_skin_before_grains_touch():
    skin = two_grains(0.0).material.skin
    packing = two_grains(1.001 * skin)
    moving = Moving(packing)
    reach = packing.radii.sum()
    shrunk = np.diag([reach / (reach + 1.001 * skin), 1.0]) @ packing.box
    assert used_up(moving, shrunk, moving.work.motion.position) >= 1
    assert used_up(moving, 0.5 * (shrunk + packing.box), moving.work.motion.position) < 0.6


def test_a_rotation_of_the_box_alone_uses_up_nothing_of_the_skin():
    moving = Moving(loose(100, 2, BOXES["skewed by 45 degrees"][1]))
    position = moving.work.motion.position
    assert used_up(moving, ROTATED @ moving.packing.box, position) < 1e-12
    assert used_up(moving, 1.001 * ROTATED @ moving.packing.box, position) < 1e-12


def test_a_run_with_rebuilds_equals_one_whose_list_is_never_rebuilt():
    box = 0.12 * np.array([[1.0, 0.2], [0.0, 1.0]])
    packing = loose(150, 8, box, LinearContact(stiffness=1e4, friction=0.3))
    settled = Moving(packing).advance(3000, 2e-5, damping=0.7).now
    gradient = np.array([[-0.4, 1.0], [0.2, 0.5]])
    ends, anchors = [], []
    for skin in (settled.material.skin, 100 * settled.material.skin):
        moving = Moving(settled, skin=skin)
        anchor = moving.work.pairs.anchor_box[0, 0].copy()
        moving.advance(2500, 2e-5, gradient, damping=0.3)
        anchors.append(moving.work.pairs.anchor_box[0, 0] != anchor)
        ends.append(moving)
    assert anchors == [True, False], "the first must rebuild its list, the second never"
    short, long = ends
    moved = np.abs(short.work.motion.position - settled.positions.T).max()
    assert moved > 0.02  # the grains did rearrange
    np.testing.assert_allclose(
        short.work.motion.position, long.work.motion.position, rtol=0, atol=1e-9
    )
    tangential = {p: short.work.pairs.tangential[0, c] for p, c in short.listed().items()}
    for pair, c in long.listed().items():
        assert long.work.pairs.tangential[0, c] == pytest.approx(
            tangential.get(pair, 0.0), rel=1e-6, abs=1e-6
        )
