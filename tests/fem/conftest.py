from tests.petsc import petsc_options  # noqa: F401
