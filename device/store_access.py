"""Who may do what in a store: its owner everything, its group (the offload's user) reads it and writes in two folders.

Modes are set and not left to the process's mask: a login whose mask lets groups write must not open the scans to them.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Final

FOLDER_MODE: Final = 0o750
FILE_MODE: Final = 0o640
SHARED_MODE: Final = 0o770
_MANY: Final = 1 << 40


def make_folder(folder: Path, mode: int) -> None:
    """Make a folder with that mode; one that is there is kept as it is."""
    if not folder.is_dir():
        folder.mkdir(parents=True)
        folder.chmod(mode)


def close_to_others(directory: Path) -> None:
    """Give a bundle's directory and files the modes of a store."""
    for path in directory.iterdir():
        path.chmod(FILE_MODE)
    directory.chmod(FOLDER_MODE)


def require_writable(folder: Path) -> None:
    """Return when files can be made in a folder.

    Raises
    ------
    OSError
        Its file system is mounted read-only, or this user may not write there.
    """
    if os.statvfs(folder).f_flag & os.ST_RDONLY:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OSError(errno.EACCES, os.strerror(errno.EACCES))


def free_entries(folder: Path) -> int:
    """How many more files a file system can name; many where it does not count them."""
    facts = os.statvfs(folder)
    return facts.f_favail if facts.f_files else _MANY
