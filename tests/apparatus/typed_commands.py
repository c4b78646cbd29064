"""Commands as a person types them: parsed by the program's own command line, and not run."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence

from cyclopts import App

from device.cli.main import app as retroscan
from device.cli.main import main as run_retroscan
from host_sync.cli.main import app as retrosync
from host_sync.cli.main import main as run_retrosync

PROGRAMS: dict[str, tuple[App, Callable[[Sequence[str]], int]]] = {
    "retroscan": (retroscan, run_retroscan),
    "retrosync": (retrosync, run_retrosync),
}


def split(line: str) -> tuple[str, list[str]]:
    """The program and the words after it."""
    program, *words = shlex.split(line, comments=True)
    return program, words


def parse(line: str) -> None:
    """Parse a command; cyclopts' error when a command, option or value does not exist or one is missing."""
    program, words = split(line)
    app = PROGRAMS[program][0]
    if not {"--help", "--version", "--install-completion"}.isdisjoint(words):
        return
    if program == "retroscan":
        _, given, _ = app.meta.parse_args(words, exit_on_error=False, print_error=False)
        words = list(given.args)
    app.parse_args(words, exit_on_error=False, print_error=False)
