"""Runs the system's own programs; nothing secret is ever an argument, because every user can read those."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from typing import Final

from device.errors import MachineError

TIMEOUT_S: Final = 20.0


class ProgramFailed(MachineError):
    """A program of the system refused; `said` is what it wrote, `code` its exit code."""

    def __init__(self, sentence: str, said: str, code: int) -> None:
        super().__init__(sentence)
        self.said = said
        self.code = code


def run_program(arguments: Sequence[str], *, feed: str = "", timeout_s: float = TIMEOUT_S) -> str:
    """Run a program and return its output.

    Parameters
    ----------
    arguments : the program and its arguments
    feed : written to its standard input

    Raises
    ------
    ProgramFailed
        It ended with an error.
    MachineError
        It is not installed, or did not end within `timeout_s`.
    """
    program = arguments[0]
    found = shutil.which(program)
    if found is None:
        raise MachineError(f"{program} is not installed on this machine: install it, or change this setting elsewhere")
    environment = {**os.environ, "LC_ALL": "C.UTF-8", "SYSTEMD_PAGER": "", "SYSTEMD_COLORS": "0"}
    try:
        ran = subprocess.run(  # noqa: S603
            [found, *arguments[1:]],
            input=feed,
            capture_output=True,
            text=True,
            errors="replace",
            env=environment,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise MachineError(f"{program} did not answer within {timeout_s:.0f} s: try again") from error
    except OSError as error:
        raise MachineError(f"{program} cannot be started: {error.strerror}") from error
    if ran.returncode:
        said = " ".join((ran.stderr or ran.stdout).split())
        raise ProgramFailed(f"{program}: {said or 'failed without a word'}", said, ran.returncode)
    return ran.stdout
