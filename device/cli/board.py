"""Choice of the board profile: `--board`, else the environment, else what the installation wrote."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from hal.errors import BoardProfileError
from hal.profile_files import profile_names

VARIABLE: Final = "RETROSCAN_BOARD"
BOARD_FILE: Final = Path("/etc/retrograph/board")
DEFAULTS_FILE: Final = Path("/etc/default/retroscan")
"""One line with a name or path; and the environment file of the services, which `board/install.sh` writes."""


def chosen_board(given: str | None, board_file: Path = BOARD_FILE, defaults_file: Path = DEFAULTS_FILE) -> str:
    """The board profile's name or path.

    Raises
    ------
    BoardProfileError
        None is named anywhere.
    """
    named = given or os.environ.get(VARIABLE) or _first_line(board_file) or _default(defaults_file)
    if named:
        return named
    raise BoardProfileError(
        f"no board is named: give --board NAME, set {VARIABLE}, or write the name into {board_file}; names are "
        f"{', '.join(profile_names())}, or a .toml file"
    )


def _first_line(path: Path) -> str:
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError):
        return ""
    return lines[0].strip()


def _default(path: Path) -> str:
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError):
        return ""
    values = [line.split("=", 1)[1].strip() for line in lines if line.startswith(f"{VARIABLE}=")]
    return values[-1] if values else ""
