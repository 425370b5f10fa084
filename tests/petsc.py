"""PETSc options of one test."""

import pytest
from petsc4py import PETSc


@pytest.fixture
def petsc_options():
    """Sets options as the command line would, and takes them back after the test."""
    before = set(PETSc.Options().getAll())
    yield PETSc.Options().insertString
    for name in set(PETSc.Options().getAll()) - before:
        PETSc.Options().delValue(name)
