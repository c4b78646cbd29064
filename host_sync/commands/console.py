"""How every command speaks: plain lines, exit codes, and folders that have a name."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from host_sync.plain_text import printable

DONE: Final = 0
PARTLY: Final = 1
BAD_INPUT: Final = 2
CONNECTION: Final = 3


def say(line: str) -> None:
    """Write one line."""
    sys.stdout.write(printable(line) + "\n")


def complain(what: object, code: int) -> int:
    """Say what is wrong; returns the exit code."""
    sys.stderr.write(f"retrosync: {printable(str(what))}\n")
    return code


@contextmanager
def telling() -> Iterator[Callable[[str], None]]:
    """A line that says what is being done and for how long."""
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=None)
        yield lambda words: progress.update(task, description=words)


def _named_folder(_: Any, tokens: Sequence[Any]) -> Path:
    text = tokens[0].value
    if not text:
        raise ValueError("an empty name is no folder")
    return Path(text)


Folder = Annotated[Path, Parameter(converter=_named_folder)]
"""A folder that was named; an empty name is refused, as it would mean the current one."""
