"""Commands that fetch, search and verify start light: the numerics are loaded by those that reconstruct."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from typing import get_args

from host_sync.calibration.calibrate import METHODS
from host_sync.cli.commands import COMMANDS
from host_sync.cli.main import app
from host_sync.cli.reconstruct import MethodName

HEAVY = ("numba", "scipy", "matplotlib", "asyncssh", "zeroconf", "numpy", "cv2", "tifffile")


def test_the_command_line_loads_no_numerics() -> None:
    said = subprocess.run(
        [sys.executable, "-c", "import sys, host_sync.cli.main; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert set(HEAVY).isdisjoint(said.stdout.split())


def test_commands_know_every_method() -> None:
    assert get_args(MethodName) == METHODS


def test_the_list_of_commands_says_what_their_docstrings_say() -> None:
    for command in COMMANDS:
        module, _, function = command.function.partition(":")
        docstring = getattr(import_module(module), function).__doc__
        first = " ".join(docstring.split("\n\n")[0].split())
        assert command.summary in ("", first), command.name


def test_every_command_is_found_by_its_name() -> None:
    assert [name for name in app if not name.startswith("-")] == [command.name for command in COMMANDS]
    assert {command.name for command in COMMANDS if not command.summary} == {"gage", "figures"}
