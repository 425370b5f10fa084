"""What a command and a demo show a user: progress, tables, one-line errors. No MPI in here."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from .dem.preparation import NotReached

USER_ERRORS = (ValueError, OSError, MemoryError, NotReached)
USER_ERROR, LOST_CONTROLLABILITY = 2, 3


class HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Defaults behind the help texts, but for options that say themselves what None means.

    Several values are shown as they would be typed.
    """

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default is None:
            return action.help
        if isinstance(action.default, tuple):
            typed = " ".join(str(value) for value in action.default)
            return f"{action.help or ''} (default: {typed})".lstrip()
        return super()._get_help_string(action)


def refuse(message: str):
    """What a parser calls for arguments that it cannot take; raises ValueError."""
    raise ValueError(f"{message}; see --help")


class LoadProgress:
    """A progress bar over a load path; lines instead, one per tenth, where nobody watches."""

    def __init__(self, end: float, quiet: bool = False, start: str = "starting: compiling"):
        """For a load that ends at `end`; `start` is said before anything is known."""
        self._end, self._shown = end, 0.0
        self._started = time.perf_counter()
        self._start = start
        self._console = Console(quiet=quiet, highlight=False)
        self._bar = Progress(
            BarColumn(bar_width=14),
            TextColumn("{task.description}"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=self._console,
            disable=not self._console.is_terminal or self._console.quiet,
        )

    def __enter__(self) -> LoadProgress:
        self._bar.start()
        self._task = self._bar.add_task(self._start, total=self._end)
        return self

    def __exit__(self, *error) -> None:
        self._bar.stop()

    def show(self, load: float, description: str) -> None:
        """The load reached, and what to say about it."""
        self._bar.update(self._task, completed=load, description=description)
        due = load - self._shown >= 0.1 * self._end or load >= self._end > self._shown
        if self._bar.disable and due:
            self._shown = load
            seconds = time.perf_counter() - self._started
            left = seconds * (self._end - load) / load
            self._console.print(f"{description}  {seconds:.0f} s, {left:.0f} s left")

    def say(self, line: str) -> None:
        """A line above the bar."""
        self._console.print(line)


def print_table(title: str, rows: Mapping[str, str], quiet: bool = False) -> None:
    """A two-column table."""
    table = Table(title=title, show_header=False, title_justify="left")
    for name, value in rows.items():
        table.add_row(name, value)
    _show(table, quiet)


def print_columns(
    title: str, names: Sequence[str], rows: Sequence[Sequence[str]], quiet: bool = False
) -> None:
    """A table with a header; all but the first column are set to the right."""
    table = Table(title=title, title_justify="left")
    for k, name in enumerate(names):
        table.add_column(name, justify="right" if k else "left")
    for row in rows:
        table.add_row(*row)
    _show(table, quiet)


def _show(table: Table, quiet: bool) -> None:
    """As wide as it needs, where no terminal sets a limit."""
    console = Console(quiet=quiet, highlight=False)
    if not console.is_terminal:
        console.width = 160
    console.print(table)
