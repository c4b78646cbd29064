"""Output of every command: plain lines, exit codes, progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated, Final, Literal, Protocol

from cyclopts import Parameter

from host_sync.kernels.cache import holds_kernels, prune_cache
from host_sync.text import printable

if TYPE_CHECKING:
    from host_sync.kernels.jit import CompileTime

DONE: Final = 0
PARTLY: Final = 1
BAD_INPUT: Final = 2
CONNECTION: Final = 3
LINES_EVERY_S = 3.0


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
    with progress("steps") as show:
        yield show


class Show(Protocol):
    """Shows a step: how much of it is done, and for which of several sources."""

    def __call__(self, step: str, done: float | None = None, total: float | None = None, source: str = "") -> None:
        """Show it; without a total, how much is done is not known."""


@contextmanager
def progress(kind: Literal["steps", "counts", "bytes"]) -> Iterator[Show]:
    """Bars on a terminal; in a log or pipe a line on standard error every few seconds, as long as something changes."""
    from rich import progress as bars  # here, because it takes as long to load as many a command takes
    from rich.console import Console

    words = bars.TextColumn("{task.description}", markup=False)
    columns = {
        "steps": (bars.SpinnerColumn(), words, bars.TimeElapsedColumn()),
        "counts": (words, bars.BarColumn(), bars.MofNCompleteColumn(), bars.TimeElapsedColumn()),
        "bytes": (
            words, bars.BarColumn(), bars.DownloadColumn(), bars.TransferSpeedColumn(), bars.TimeRemainingColumn(),
        ),
    }[kind]  # fmt: skip
    console, tasks, lines, ended = Console(stderr=True), dict[str, bars.TaskID](), dict[str, str](), Event()
    with bars.Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:

        def show(step: str, done: float | None = None, total: float | None = None, source: str = "") -> None:
            if source not in tasks:
                tasks[source] = shown.add_task("", total=None)
            shown.update(tasks[source], description=step, completed=done or 0, total=total)
            lines[source] = f"{step}, {(done or 0) / total:.0%}" if total else step

        writer = Thread(target=_write_lines, args=(lines, ended), daemon=True)
        if not console.is_terminal:
            writer.start()
        try:
            yield show
        finally:
            ended.set()
            if not console.is_terminal:
                writer.join()


def _write_lines(lines: dict[str, str], ended: Event) -> None:
    """Write the lines that have changed since the last time, again and again until the end."""
    before: dict[str, str] = {}
    while not ended.wait(LINES_EVERY_S):
        now = dict(lines)
        for source, line in now.items():
            if before.get(source) != line:
                print_error(line, DONE)
        before = now


OutputFile = Annotated[Path | None, Parameter(allow_leading_hyphen=True)]
"""A file to write; - is standard output."""


_COMPILE_TIMES: Final[list[CompileTime]] = []
"""What measures the compiling of this run, once it was announced."""


def announce_compiling() -> None:
    """Write one line to a terminal when this run will compile; not to a log or pipe.

    `report_compile_time` then says how long it took.
    """
    prune_cache()
    if sys.stderr.isatty() and not holds_kernels() and not _COMPILE_TIMES:
        sys.stderr.write("retrosync: this first run compiles for this machine, about a minute; later runs do not\n")
        from host_sync.kernels.jit import CompileTime  # here, because it loads the compiler

        _COMPILE_TIMES.append(CompileTime())


def report_compile_time() -> None:
    """Write how long the compiling took that was announced, if any was."""
    while _COMPILE_TIMES:
        taken_s = _COMPILE_TIMES.pop().total_s
        sys.stderr.write(f"retrosync: {taken_s:.0f} s of this run were compiling; the result is kept for later runs\n")
