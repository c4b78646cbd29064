"""Output of every command: plain lines, exit codes, progress; named folders and renamed commands."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import App, Parameter
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from host_sync.text import printable

DONE: Final = 0
PARTLY: Final = 1
BAD_INPUT: Final = 2
CONNECTION: Final = 3


def print_line(line: str) -> None:
    """Write one line."""
    sys.stdout.write(printable(line) + "\n")


def print_error(what: object, code: int) -> int:
    """Write what is wrong; returns the exit code."""
    sys.stderr.write(f"retrosync: {printable(str(what))}\n")
    return code


@contextmanager
def status_spinner() -> Iterator[Callable[[str], None]]:
    """A line with the current step and its time."""
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=None)
        yield lambda words: progress.update(task, description=words)


def add_renamed(app: App, command: Callable[..., int], *, old: str, new: str) -> None:
    """Add a command, and for one release its old name as a hidden alias that names the new one."""

    @functools.wraps(command)
    def under_old_name(*arguments: Any, **named: Any) -> int:
        print_error(f"`{old}` is now `{new}`; the old name will be removed in the next release", DONE)
        return command(*arguments, **named)

    app.command(command, name=new)
    app.command(under_old_name, name=old, show=False)


def _named_folder(_: Any, tokens: Sequence[Any]) -> Path:
    text = tokens[0].value
    if not text:
        raise ValueError("an empty name is not a folder")
    return Path(text)


Folder = Annotated[Path, Parameter(converter=_named_folder)]
"""A named folder; an empty name is refused, because it would mean the current folder."""
