"""PETSc options: the defaults of our solver, and those of the command line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from petsc4py import PETSc

PREFIX = "femxdem_"

DEFAULTS = {
    "snes_type": "python",
    "snes_python_type": "femxdem_fenicsx.fem.anderson.Anderson",
    "snes_linesearch_type": "basic",  # of other types: no law evaluations but one per iteration
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
}


def petsc_options(arguments: Sequence[str]) -> None:
    """Hand the arguments that argparse left over to PETSc.

    Use it as ``arguments, rest = parser.parse_known_args(); petsc_options(rest)``. Options of the
    nonlinear solver start with ``-femxdem_``: ``-femxdem_snes_monitor``.

    Raises:
        ValueError: an argument that can be no PETSc option, like a misspelt option of the script.
    """
    follows_option = False
    for argument in arguments:
        is_option = argument.startswith("-") and not _is_number(argument)
        if argument.startswith("--") or not (is_option or follows_option):
            raise ValueError(f"unknown argument {argument!r}: see --help")
        follows_option = is_option
    PETSc.Options().insertString(" ".join(arguments))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@contextmanager
def defaults(prefix: str) -> Iterator[None]:
    """Our defaults in the options database, where the user has not set anything, for a while."""
    options = PETSc.Options(prefix)
    ours = {name: value for name, value in DEFAULTS.items() if not options.hasName(name)}
    for name, value in ours.items():
        options[name] = value
    try:
        yield
    finally:
        for name in ours:
            options.delValue(name)


def set_from_options(snes: PETSc.SNES, matrix: PETSc.Mat) -> None:
    """Let the solver take its options: the user's, and our defaults where there are none.

    Raises ValueError, with what the user gave, where PETSc does not know a type, cannot read a
    value, or has no such factorisation of this matrix.
    """
    prefix = snes.getOptionsPrefix()
    given = PETSc.Options(prefix).getAll()
    with defaults(prefix):
        try:
            snes.setFromOptions()
            pc = snes.getKSP().getPC()
            if pc.getType() in ("lu", "cholesky"):
                pc.setOperators(matrix)
                pc.setFactorSetUpSolverType()
        except PETSc.Error as error:
            told = " ".join(f"-{prefix}{name} {value}".strip() for name, value in given.items())
            raise ValueError(
                f"PETSc does not take one of the options {told} (its error {error.ierr})"
            ) from None
