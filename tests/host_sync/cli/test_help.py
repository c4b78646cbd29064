"""`--help` says of every argument what it is."""

from __future__ import annotations

import pytest
from cyclopts import App

from host_sync.cli.main import app, main

COMMANDS = [name for name in app if not name.startswith("-")]


def test_the_commands_are_found() -> None:
    assert {"pull", "search", "reconstruct", "measure", "view"} <= set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_argument_is_explained(name: str) -> None:
    command: App = app[name]
    arguments = command.assemble_argument_collection(parse_docstring=True)
    shown = [argument for argument in arguments if argument.show]
    assert not [argument.name for argument in shown if not argument.parameter.help]


@pytest.mark.parametrize(
    ("old", "new", "arguments", "code"),
    [("gage", "gage-rr", ["--table", "none.csv"], 2), ("figures", "paper-figures", ["--out", "pictures"], 2)],
)
def test_an_old_name_names_the_new_one_and_still_works(
    capsys: pytest.CaptureFixture[str], old: str, new: str, arguments: list[str], code: int
) -> None:
    assert main([new, *arguments]) == code
    said = capsys.readouterr().err
    assert main([old, *arguments]) == code
    assert capsys.readouterr().err == (
        f"retrosync: `{old}` is now `{new}`; the old name will be removed in the next release\n{said}"
    )
    assert not app[old].show
