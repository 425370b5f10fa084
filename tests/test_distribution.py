"""Packings on home ranks: where they are changes nothing but the time."""

import json
import subprocess
import sys

import numpy as np
import pytest

from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.files import save_packing
from femxdem_fenicsx.dem.preparation import random_packing
from femxdem_fenicsx.distribution import IMBALANCE_ALLOWED, better_homes, busiest, loads, place
from tests.mpi import ROOT, run_on_ranks
from tests.reference import DATA

MODULE = "tests.distribution_run"


# Placement


def costs(count: int = 512, seed: int = 0) -> np.ndarray:
    """As of a shear band: one packing in ten takes about ten times the steps of the others."""
    rng = np.random.default_rng(seed)
    return 100 * rng.lognormal(0, 0.2, count) * np.where(rng.random(count) < 0.1, 10, 1)


@pytest.mark.parametrize("ranks", [2, 10, 50, 500])
def test_no_rank_gets_more_than_graham_allows(ranks):
    cost = costs()
    home = np.arange(512) * ranks // 512
    load = loads(cost, place(cost, home, ranks), ranks)
    least = max(cost.sum() / ranks, cost.max())  # no placement is better
    assert load.max() <= (4 / 3 - 1 / (3 * ranks)) * least
    assert load.sum() == pytest.approx(cost.sum())
    if ranks <= 10:
        assert load.max() <= IMBALANCE_ALLOWED * least


@pytest.mark.parametrize("ranks, threads", [(2, 25), (5, 10), (10, 3)])
def test_no_thread_gets_more_than_graham_allows(ranks, threads):
    cost, workers = costs(), ranks * threads
    home = np.minimum(np.arange(512) ** 2 // 512, 511) * ranks // 512
    least = max(cost.sum() / workers, cost.max())
    before, after = (
        busiest(cost, h, ranks, threads) for h in (home, place(cost, home, ranks, threads))
    )
    assert after <= (4 / 3 - 1 / (3 * workers)) * least < before


def test_nothing_moves_where_the_longest_packing_sets_the_time_anyway():
    home = np.arange(8) // 2
    cost = np.array([9, 1, 2, 2, 2, 2, 2, 2]) * 1e6
    assert loads(cost, home, 4).max() > IMBALANCE_ALLOWED * cost.sum() / 4
    assert better_homes(cost, home, 4, threads=2) is None
    moved = better_homes(cost, home, 4, threads=1)
    assert loads(cost, moved, 4).max() == 9e6
    assert better_homes(cost / 1e5, home, 4, threads=1) is None  # it takes longer than it gains


def test_packings_that_may_stay_at_home_do():
    cost = costs()
    home = place(cost, np.arange(512) % 10, 10)
    assert np.array_equal(place(cost, home, 10), home)
    changed = cost * np.random.default_rng(1).lognormal(0, 0.05, 512)
    new = place(changed, home, 10)
    assert 0 < (new != home).sum() < 512 / 4  # most of them, not one in ten, as from scratch
    assert loads(changed, new, 10).max() < loads(changed, home, 10).max()


def test_equal_packings_move_only_from_ranks_that_have_more_than_their_share():
    home = np.array([0] * 6 + [1] * 2)
    new = place(np.ones(8), home, 2)
    assert loads(np.ones(8), new, 2).tolist() == [4, 4]
    assert (new[6:] == 1).all() and (new != home).sum() == 2


def test_more_ranks_than_packings_leaves_some_without_any():
    load = loads(np.ones(3), place(np.ones(3), np.zeros(3, int), 5), 5)
    assert sorted(load) == [0, 0, 1, 1, 1]


# Results


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    """(ranks, threads, wander) -> packings and all answers; and what the run told."""
    folder = tmp_path_factory.mktemp("distribution")
    law = LinearContact(modulus=6e8, stiffness_ratio=0.8, friction=0.5)
    save_packing(folder / "packing.h5", random_packing(60, (3e-3, 7e-3), law, 1e5, seed=3))
    found, told = {}, {}
    for case in (
        (1, 1, "stay"),
        (1, 2, "stay"),
        (2, 1, "wander"),
        (2, 1, "stay"),
        (3, 1, "wander"),
    ):
        ranks, threads, wander = case
        run = run_on_ranks(
            ranks, MODULE, "grains", str(folder), str(folder / "packing.h5"), str(threads), wander
        )
        assert run.returncode == 0, run.stderr
        told[case] = json.loads(run.stdout)
        with np.load(folder / "states.npz") as arrays:
            found[case] = dict(arrays)
    return found, told


def test_states_and_answers_are_the_same_to_the_last_bit_on_any_ranks_threads_and_homes(states):
    first, *others = states[0].items()
    assert len(first[1]["position"]) == 7 and np.ptp(first[1]["answer_0"]) > 1e4
    for case, arrays in others:
        assert arrays.keys() == first[1].keys()
        for name, array in arrays.items():
            assert np.array_equal(array, first[1][name]), (case, name)


def test_an_evaluation_sends_F_there_and_the_stress_back_and_nothing_else(states):
    told = states[1]
    assert told[1, 1, "stay"]["sent"] == 0
    per_point = 2 * 4 * 8  # F and stress
    assert 0 < told[2, 1, "stay"]["sent"] <= 7 * 8 * per_point  # 7 points, 8 evaluations


def test_spheres_in_plane_strain_answer_the_same_on_two_ranks():
    """The law in 3D lives on other ranks than the points of the plane."""
    found = []
    for ranks in (1, 2):
        run = run_on_ranks(ranks, MODULE, "plane_strain", str(DATA))
        assert run.returncode == 0, run.stderr
        found.append(json.loads(run.stdout))
    one, two = found
    assert len(one["shown"]) == 2 and one["evaluations"] == two["evaluations"]
    np.testing.assert_allclose(two["shown"], one["shown"], rtol=1e-8, atol=1e-3)
    assert np.abs(one["shown"]).max() > 1e5


def test_costs_that_differ_thirty_times_are_balanced_before_they_are_paid_again():
    run = run_on_ranks(2, MODULE, "uneven")
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout)
    (before, after, moved), *later = told["found"]
    assert before > 1.7 and after <= IMBALANCE_ALLOWED and moved > 0
    for again in later:
        assert again[0] <= IMBALANCE_ALLOWED and again[2] == 0
    assert sum(told["sizes"]) == 40


@pytest.mark.parametrize(
    "kind, name", [("astray", "InadmissibleDeformation"), ("broken", "OSError")]
)
def test_what_a_packing_raises_at_home_reaches_the_rank_of_its_point(kind, name):
    run = run_on_ranks(2, MODULE, "failing", kind, timeout=60)
    first, last = json.loads(run.stdout)["errors"]
    if kind == "astray":
        assert first == last == f"{name}: grains gone"
    else:
        assert first == f"RuntimeError: on rank 1: {name}: grains gone"
        assert last == f"{name}: grains gone"


def test_one_rank_imports_no_distribution():
    code = """
import sys
from mpi4py import MPI
from demos import biaxial
from femxdem_fenicsx import arguments, script
words = ["--mesh", "1", "1", "--packing", "tests/data/yade/packing.h5"]
args = script.parse(biaxial.arguments(), MPI.COMM_WORLD, words)
biaxial.specimen_for(args, arguments.packing_for(args, MPI.COMM_WORLD, 2), MPI.COMM_WORLD)
print("femxdem_fenicsx.distribution" in sys.modules)
"""
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert run.stdout.strip() == "False", run.stderr
