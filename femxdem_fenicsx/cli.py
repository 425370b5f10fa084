"""`femxdem`: the laboratory for packings, without any mesh and without FEniCSx."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from . import __version__, terminal, writing
from .commands import calibrate, element_test, packing, tradeoff


def parser() -> argparse.ArgumentParser:
    """The whole command line; every subcommand leaves its function in `run`."""
    top = Parser(prog="femxdem", description="Laboratory for packings of grains.")
    top.add_argument("--version", action="version", version=f"femxdem {__version__}")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)
    for command in (packing, element_test, calibrate, tradeoff):
        command.add(commands)
    return top


class Parser(argparse.ArgumentParser):
    """Shows defaults, and raises ValueError for what it cannot take."""

    def __init__(self, *args, **options):
        super().__init__(*args, formatter_class=terminal.HelpFormatter, **options)

    def error(self, message: str):
        """In one line, as all errors of a user."""
        terminal.refuse(message)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; its exit code. A user's mistake is one line and exit code 2."""
    try:
        args = parser().parse_args(arguments)
        if getattr(args, "output", None) is not None:
            writing.check_writable(args.output)  # now, not after an hour
        return args.run(args)
    except terminal.USER_ERRORS as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        return terminal.USER_ERROR
    except BrokenPipeError:  # the reader of our output has gone, e.g. `| head`
        sys.stderr.close()
        return 0
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr, flush=True)
        return 130


if __name__ == "__main__":
    sys.exit(main())
