"""A demo run on one rank, and what it used: ``python -m tests.scene_run DEMO FOLDER words ...``.

Where the process was started with the library of `mpi_calls.c` preloaded, calls of MPI are counted.
Prints one JSON object.
"""

import ctypes
import json
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI


def counted(owner, name: str, counts: dict[str, list[int]], calls) -> None:
    """Let a method count how often it is called, and the calls of MPI that it makes."""
    method = getattr(owner, name)
    entry = counts[f"{owner.__name__}.{name}"] = [0, 0]

    def counting(*args, **options):
        before = calls()
        try:
            return method(*args, **options)
        finally:
            entry[0] += 1
            entry[1] += calls() - before

    setattr(owner, name, counting)


def property_counted(owner, name: str, counts: dict[str, int]) -> None:
    """Let a property count how often it is read."""
    value, counts[name] = getattr(owner, name), 0

    def reading(self):
        counts[name] += 1
        return value.fget(self)

    setattr(owner, name, property(reading))


def main(demo: str, library: str, folder: Path, words: list[str]) -> None:
    calls = ctypes.CDLL(library).mpi_calls
    calls.restype = ctypes.c_long
    sys.path.insert(0, "demos")
    from femxdem_fenicsx.fem.external_operator import ExternalOperator
    from femxdem_fenicsx.fem.problem import Problem
    from femxdem_fenicsx.homogenised_law import HomogenisedLaw

    scene = __import__(demo)
    methods: dict[str, list[int]] = {}
    for name in ("evaluate", "evaluate_tangent", "commit"):
        counted(ExternalOperator, name, methods, calls)
    counted(HomogenisedLaw, "evaluate", methods, calls)
    counted(HomogenisedLaw, "tangent", methods, calls)
    counted(Problem, "_assemble_jacobian", methods, calls)
    fields: dict[str, int] = {}
    for name in ("deviatoric_strain", "fabric_anisotropy", "coordination_number", "deformation"):
        property_counted(HomogenisedLaw, name, fields)
    specimens, arrays = [], {}
    made = scene.specimen_for

    def keeping(*args):
        specimens.append(made(*args))
        return specimens[0]

    scene.specimen_for = keeping
    scene.pictures = lambda *args: None
    before = calls()
    sys.argv = [demo, "--quiet", "--output", str(folder), *words]
    code = scene.main(MPI.COMM_WORLD)
    law = specimens[0].law
    for name, array in law.response.committed.__dict__.items():
        if isinstance(array, np.ndarray):
            arrays[name] = array.shape
    for name, array in law.response.committed_outcome._asdict().items():
        arrays[f"outcome/{name}"] = array.shape
    problem = specimens[0].problem
    print(
        json.dumps(
            {
                "code": code,
                "modules": [name for name in sys.modules if name.startswith(("fem", "forms"))],
                "dofs": problem.u.x.array.size,
                "functions": {
                    "stress": problem.operator.stress.x.array.size // law.size,
                    "tangent": problem.operator.tangent.x.array.size // law.size,
                },
                "methods": methods,
                "mpi": calls() - before,
                "fields": fields,
                "arrays": arrays,
            }
        )
    )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]), sys.argv[4:])
