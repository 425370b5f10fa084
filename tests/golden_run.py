"""What must have the same bits on every CPU: `python -m tests.golden_run [disks spheres coupled]`.

Prints, as JSON, a few numbers for people and a hash of all bits of each part. The golden values are
those of `tests/data/golden.json`; `python -m tests.golden_run > tests/data/golden.json` writes them
anew, after a change that is meant to change results.
"""

from __future__ import annotations

import hashlib
import json
import sys

import numpy as np

from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.element_tests import drained_compression, simple_shear
from femxdem_fenicsx.dem.mixed_control import ElementState, Servo
from femxdem_fenicsx.dem.packing import Packing
from femxdem_fenicsx.dem.preparation import random_packing
from femxdem_fenicsx.homogenised_law import HomogenisedLaw

LAW = LinearContact(modulus=6e8, stiffness_ratio=0.8, friction=0.5)
PRESSURE = 1e5


def bits(*arrays: np.ndarray) -> str:
    """A hash of the bytes of arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def prepared(grains: int, dim: int) -> Packing:
    return random_packing(
        grains, law=LAW, pressure=PRESSURE, compaction_friction=0.2, seed=1, dim=dim
    )


def of_packing(packing: Packing) -> dict:
    arrays = packing.box, packing.positions, packing.radii, packing.contacts, packing.tangential
    return {"void_ratio": packing.void_ratio, "packing": bits(*arrays)}


def of_test(states: list[ElementState]) -> dict:
    stress = np.array([state.stress for state in states])
    deformation = np.array([state.deformation for state in states])
    return {"last_stress_Pa": stress[-1].tolist(), "element_test": bits(stress, deformation)}


def disks() -> dict:
    """A packing of disks and its drained biaxial test to 2 %, then shear at constant volume."""
    packing = prepared(80, 2)
    servo = Servo(HomogenisedLaw(packing, 1), 1e-3 * PRESSURE)
    states = list(drained_compression(servo, PRESSURE, 0.02))
    states += simple_shear(servo, 0.01)
    return of_packing(packing) | of_test(states)


def spheres() -> dict:
    """A packing of spheres and its drained triaxial test to 0.5 %."""
    packing = prepared(60, 3)
    servo = Servo(HomogenisedLaw(packing, 1), 1e-3 * PRESSURE)
    return of_packing(packing) | of_test(list(drained_compression(servo, PRESSURE, 0.005)))


def coupled() -> dict:
    """Five steps of a rough specimen of 2 x 2 elements; packings in the order of their places."""
    from femxdem_fenicsx.fem.stepping import (
        LoadStepping,
        walk,
    )
    from tests.fem.specimen import Specimen

    packing, forces = prepared(80, 2), []
    scene = Specimen(
        lambda points: HomogenisedLaw(packing, points.size, operator_name="PSTLO-secant"),
        name="Q4", cells=(2, 2), distortion=0.0, rough=True, tolerance=1e-3,
    )  # fmt: skip
    scene.pressure.value = PRESSURE
    outcome = walk(
        scene.problem, scene.compress, 0.005, LoadStepping(0.001),
        lambda record: forces.append(scene.top_force()),
    )  # fmt: skip
    comm, state = scene.mesh.comm, scene.law.response.committed
    mine = scene.points.coordinates(), state.box, state.position, scene.law.stress
    everywhere = [np.concatenate(part) for part in zip(*comm.allgather(mine), strict=True)]
    order = np.lexsort(np.round(everywhere[0], 9).T)
    return {
        "evaluations": outcome.evaluations,
        "last_force_N": forces[-1],
        "packings": bits(*(array[order] for array in everywhere[1:])),
    }


PARTS = {"disks": disks, "spheres": spheres, "coupled": coupled}


if __name__ == "__main__":
    found = {name: PARTS[name]() for name in sys.argv[1:] or PARTS}
    if "coupled" not in found:
        print(json.dumps(found, indent=1))
        sys.exit()
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found, indent=1))
