"""The table of commands and the numerics, which it does not import, agree."""

from __future__ import annotations

from typing import get_args

from host_sync.calibration.calibrate import METHODS
from host_sync.cli.commands import COMMANDS
from host_sync.cli.main import app
from host_sync.cli.reconstruct import MethodName


def test_commands_know_every_method() -> None:
    assert get_args(MethodName) == METHODS


def test_every_command_is_found_by_its_name() -> None:
    assert [name for name in app if not name.startswith("-")] == [command.name for command in COMMANDS]
    assert {command.name for command in COMMANDS if not command.summary} == {"gage", "figures"}
