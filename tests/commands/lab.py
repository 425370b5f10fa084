"""The command line in this process: exit code and what it says."""

from dataclasses import dataclass

import pytest

from femxdem_fenicsx import cli


@dataclass
class Result:
    code: int
    out: str
    error: str


@pytest.fixture
def femxdem(capsys):
    """Call it with the words of a command."""

    def run(*words: object) -> Result:
        code = cli.main([str(word) for word in words])
        return Result(code, *capsys.readouterr())

    return run


def assert_refused(result: Result, *words: str) -> None:
    """Exit code 2 and one line that has these words."""
    assert result.code == 2, result
    assert result.error.startswith("error: ") and result.error.count("\n") == 1, result.error
    for word in words:
        assert word in result.error, result.error
