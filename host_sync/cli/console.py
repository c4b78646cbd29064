"""Output of every command: plain lines, exit codes, progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

from host_sync.kernels.cache import holds_kernels, prune_cache
from host_sync.text import printable

if TYPE_CHECKING:
    from host_sync.kernels.compile_time import CompileTime

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
    from rich.console import Console  # here, because it takes as long to load as many a command takes
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=None)
        yield lambda words: progress.update(task, description=words)


OutputFile = Annotated[Path | None, Parameter(allow_leading_hyphen=True)]
"""A file to write; - is standard output."""


_COMPILE_TIMES: Final[list[CompileTime]] = []
"""What measures the compiling of this run, once it was announced."""


def tell_of_compiling() -> None:
    """Write one line to a terminal when this run will compile; not to a log or pipe.

    `tell_compile_time` then says how long it took.
    """
    prune_cache()
    if sys.stderr.isatty() and not holds_kernels() and not _COMPILE_TIMES:
        sys.stderr.write("retrosync: this first run compiles for this machine, about a minute; later runs do not\n")
        from host_sync.kernels.compile_time import CompileTime  # here, because it loads the compiler

        _COMPILE_TIMES.append(CompileTime())


def tell_compile_time() -> None:
    """Write how long the compiling took that was announced, if any was."""
    while _COMPILE_TIMES:
        taken_s = _COMPILE_TIMES.pop().total_s
        sys.stderr.write(f"retrosync: {taken_s:.0f} s of this run were compiling; the result is kept for later runs\n")
