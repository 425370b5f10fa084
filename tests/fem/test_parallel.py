"""The same numbers on one and two ranks, and errors that end all ranks."""

import json

import numpy as np

from tests.mpi import run_on_ranks

MODULE = "tests.fem.parallel_run"


def test_one_and_two_ranks_give_the_same_numbers():
    one, two = (run_on_ranks(ranks, MODULE, "numbers") for ranks in (1, 2))
    assert one.returncode == two.returncode == 0, one.stderr + two.stderr
    one, two = json.loads(one.stdout), json.loads(two.stdout)
    assert one.keys() == two.keys()
    for case, numbers in one.items():
        # an unstable motion amplifies rounding, and so does a load that hardly changes
        tolerance = {"crossing": 1e-8, "indirect": 1e-10}.get(case, 1e-12)
        np.testing.assert_allclose(two[case], numbers, rtol=tolerance, err_msg=case)


def test_a_law_that_raises_on_one_rank_ends_both_with_its_message(tmp_path):
    run = run_on_ranks(2, MODULE, "raise", str(tmp_path), timeout=60)
    assert run.returncode != 0
    assert (tmp_path / "rank1").read_text() == "the packing exploded"
    assert (tmp_path / "rank0").read_text() == "on rank 1: RuntimeError: the packing exploded"


def test_a_law_that_gives_up_on_one_rank_cuts_the_step_on_both():
    run = run_on_ranks(2, MODULE, "astray", timeout=60)
    assert run.returncode == 0, run.stderr
    result = json.loads(run.stdout)
    assert result["load"] == 0.02 and result["cuts"] > 0
