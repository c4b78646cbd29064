"""Permissions of a store: its owner may do everything; its group (the offload user) reads, and writes in two folders.

Modes are set explicitly, because a umask that lets groups write must not open the scans to them.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Final

FOLDER_MODE: Final = 0o750
FILE_MODE: Final = 0o640
SHARED_MODE: Final = 0o770
UNWRITABLE: Final = 0o555
_MANY: Final = 1 << 40

StatVfs = Callable[[Path], "os.statvfs_result"]
"""What a file system says of itself, as `os.statvfs` does, which Windows lacks: a store lives on a handheld."""


def make_folder(folder: Path, mode: int) -> None:
    """Make a folder with that mode; an existing one is kept as it is."""
    if not folder.is_dir():
        folder.mkdir(parents=True)
        folder.chmod(mode)


def set_store_modes(directory: Path) -> None:
    """Give a bundle's directory and files the modes of a store."""
    for path in directory.iterdir():
        path.chmod(FILE_MODE)
    directory.chmod(FOLDER_MODE)


def make_files_read_only(directory: Path) -> None:
    """Take the right to write from every file of a directory; new files may still be added."""
    for path in directory.iterdir():
        path.chmod(path.lstat().st_mode & UNWRITABLE)


def require_writable(folder: Path, statvfs: StatVfs) -> None:
    """Return when this user can make files in a folder.

    Raises
    ------
    OSError
        Its file system is mounted read-only, or this user may not write there.
    """
    if statvfs(folder).f_flag & os.ST_RDONLY:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OSError(errno.EACCES, os.strerror(errno.EACCES))


def free_bytes(folder: Path, statvfs: StatVfs) -> int:
    """Return the space for this user on a file system, bytes."""
    facts = statvfs(folder)
    return facts.f_bavail * facts.f_frsize


def free_entries(folder: Path, statvfs: StatVfs) -> int:
    """Return how many more files a file system can hold; 2^40 where it does not count them."""
    facts = statvfs(folder)
    return facts.f_favail if facts.f_files else _MANY
