"""How every command speaks: plain lines, exit codes, and folders that have a name."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter

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


def printable(text: str) -> str:
    """The same with every control character written out: what a record or a file's name says never moves a terminal."""
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)


def _named_folder(_: Any, tokens: Sequence[Any]) -> Path:
    text = tokens[0].value
    if not text:
        raise ValueError("an empty name is no folder")
    return Path(text)


Folder = Annotated[Path, Parameter(converter=_named_folder)]
"""A folder that was named; an empty name is refused, as it would mean the current one."""
