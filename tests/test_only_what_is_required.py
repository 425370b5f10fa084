"""The program models only what a scene requires: what a run loads, makes, computes and sends."""

import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from femxdem_fenicsx.dem import dynamics
from femxdem_fenicsx.dem.contacts import Bonds, LinearContact, RollingResistance
from femxdem_fenicsx.dem.packing import PackingBatch
from tests.dem.scenes import STIFFNESS, Moving, cubic, hexagonal
from tests.mpi import ROOT

BASE = ("--grains", "64", "--mesh", "1", "2", "--strain", "0.003", "--accuracy", "fast",
        "--formulation", "small", "--element", "Q8")  # fmt: skip
SECOND = ("--gradient", "second", "--second-gradient-modulus", "10")


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Path:
    """`mpi_calls.c`, compiled."""
    path = tmp_path_factory.mktemp("mpi") / "mpi_calls.so"
    source = Path(__file__).with_name("mpi_calls.c")
    subprocess.run(["mpicc", "-shared", "-fPIC", "-O1", "-o", path, source], check=True)
    return path


def run(library: Path, folder: Path, *words: str) -> dict:
    """What the biaxial demo used on one rank (`scene_run`)."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.scene_run", "biaxial", library, folder, *BASE, *words],
        cwd=ROOT, capture_output=True, text=True, timeout=180,
        env={**os.environ, "OMP_NUM_THREADS": "1", "LD_PRELOAD": str(library)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def first(library, tmp_path_factory) -> dict:
    """A first-gradient run that asks for one field."""
    folder = tmp_path_factory.mktemp("first")
    return run(library, folder, "--fields", "void_ratio") | {"folder": folder}


@pytest.fixture(scope="module")
def second(library, tmp_path_factory) -> dict:
    folder = tmp_path_factory.mktemp("second")
    return run(library, folder, *SECOND) | {"folder": folder}


# The continuum


def test_a_first_gradient_run_has_neither_the_form_nor_the_spaces_of_the_second(first, second):
    assert "forms.second_gradient" in second["modules"]
    assert "forms.second_gradient" not in first["modules"]
    assert first["dofs"] == 2 * 13  # displacements of a 1 x 2 mesh of Q8, nothing else
    assert second["dofs"] > 2 * first["dofs"]


def test_a_tangent_is_computed_where_the_solver_assembles_a_jacobian_and_nowhere_else(first):
    methods = first["methods"]
    tangents, _ = methods["HomogenisedLaw.tangent"]
    assert tangents == methods["Problem._assemble_jacobian"][0]
    assert 0 < tangents < methods["HomogenisedLaw.evaluate"][0]


def test_fields_that_nobody_asked_for_are_not_computed_and_not_written(first, second):
    def written(folder: Path) -> set[str]:
        with h5py.File(folder / "biaxial_fields" / "000003.h5") as file:
            return set(file)

    assert written(first["folder"]) == {"displacement", "void_ratio"}
    assert first["fields"]["fabric_anisotropy"] == first["fields"]["coordination_number"] == 0
    assert first["fields"]["deviatoric_strain"] == 0
    assert {"stress", "fabric_anisotropy", "deviatoric_strain"} < written(second["folder"])
    assert second["fields"]["fabric_anisotropy"] == 4  # at the beginning and after each step


def test_a_run_on_one_rank_sends_nothing_while_it_computes(first):
    """No call of MPI in an evaluation, a tangent, a commit; packings are not distributed."""
    assert first["mpi"] > 0  # calls are seen: DOLFINx makes some for its mesh, PETSc for its norms
    for name in ("evaluate", "evaluate_tangent", "commit"):
        times, messages = first["methods"][f"ExternalOperator.{name}"]
        assert times >= 2
        assert messages == 0, name
    assert "femxdem_fenicsx.distribution" not in first["modules"]


# Two dimensions


def test_a_scene_in_two_dimensions_has_no_third_component(first):
    """A spin, a rolling moment and a tangential force have one component there."""
    assert first["functions"] == {"stress": 2 * 2, "tangent": (2 * 2) ** 2}
    n, grains = 8, 64
    arrays = {name: tuple(shape) for name, shape in first["arrays"].items()}
    room = arrays["second"][1]
    assert arrays == {
        "box": (n, 2, 2),
        "position": (n, 2, grains),
        "flow": (n, 2 + 1, grains),  # velocities, spin
        "flow_gradient": (n, 2, 2),
        "turns": (n, 2, 2),
        "row": (n, grains + 1),
        "second": (n, room),
        "tangential": (n, 1, room),
        "memory": (n, 0, room),
        "outcome/stress": (n, 2, 2),
        "outcome/fabric": (n, 2, 2),
        **{
            f"outcome/{name}": (n,)
            for name in (
                "loading_steps", "hold_steps", "unbalance", "at_rest", "contacts", "overlap",
                "inertial_number", "vibration",
            )
        },
    }  # fmt: skip


def test_a_work_space_in_two_dimensions_is_that_much_smaller():
    """Values per grain and per pair; net force and moment of a grain fill a vector of 4 or 8."""
    for dim, of_motion, of_forces in ((2, 2 + 2 + 1, (2, 1, 4)), (3, 3 + 3 + 3, (3, 3, 8))):
        work = dynamics.workspace(10, dim, 50, viscous=False)
        motion = work.motion
        assert len(motion.position) + len(motion.velocity) + len(motion.rim_velocity) == of_motion
        forces = work.forces
        assert (len(forces.pair), len(forces.pair_moment), forces.grain.shape[1]) == of_forces
        assert len(work.pairs.tangential) == len(work.history.tangential) == (1 if dim == 2 else 3)
        assert len(work.pairs.shift) == dim


# Contacts


@pytest.mark.parametrize(
    ("parts", "disks", "spheres"),
    [
        ({}, 0, 0),
        ({"rolling": RollingResistance(0.1)}, 1, 3),
        ({"bonds": Bonds(1.0, 1.0)}, 1, 1),
        ({"rolling": RollingResistance(0.1), "bonds": Bonds(1.0, 1.0)}, 2, 4),
    ],
)
def test_contacts_remember_what_their_law_needs_and_nothing_else(parts, disks, spheres):
    law = LinearContact(stiffness=STIFFNESS, friction=0.5, **parts)
    for packing, remembered in ((hexagonal(4, 4, law=law), disks), (cubic(4, law=law), spheres)):
        assert PackingBatch.of(packing, 3).memory.shape[:2] == (3, remembered)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_kernels_look_at_spins_and_tangential_forces_where_there_is_friction_alone(friction):
    """They are not a number here: any use of them is seen in the motion."""
    law = LinearContact(stiffness=STIFFNESS, friction=friction)
    packing = hexagonal(4, 4, overlap=1e-2, law=law)
    velocity = np.random.default_rng(0).normal(0, 1e-3, (packing.size, 2))
    motions = []
    for value in (0.0, np.nan):
        moving = Moving(packing, velocity)
        for array in (
            moving.work.motion.rim_velocity, moving.work.pairs.tangential,
            moving.work.history.tangential, moving.work.forces.pair_moment,
        ):  # fmt: skip
            array[:] = value
        moving.advance(200, 1e-6, damping=0.3)
        motions.append(moving.velocity)
    assert np.abs(motions[0] - velocity).max() > 1e-6
    assert np.array_equal(*motions) == (friction == 0)
