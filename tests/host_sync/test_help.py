"""`--help` says of every argument what it is."""

from __future__ import annotations

import pytest
from cyclopts import App

from host_sync.__main__ import app

COMMANDS = [name for name in app if not name.startswith("-")]


def test_the_commands_are_found() -> None:
    assert {"pull", "search", "reconstruct", "measure", "view"} <= set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_argument_is_explained(name: str) -> None:
    command: App = app[name]
    arguments = command.assemble_argument_collection(parse_docstring=True)
    shown = [argument for argument in arguments if argument.show]
    assert not [argument.name for argument in shown if not argument.parameter.help]
