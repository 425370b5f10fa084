"""PETSc options of one test."""

import pytest


@pytest.fixture
def petsc_options():
    """Sets options as the command line would, and takes them back after the test."""
    # Not above: a conftest that starts MPI hands its variables to the processes of pytest-xdist.
    from petsc4py import PETSc

    before = set(PETSc.Options().getAll())
    yield PETSc.Options().insertString
    for name in set(PETSc.Options().getAll()) - before:
        PETSc.Options().delValue(name)
