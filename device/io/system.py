"""Permissions of a store, the operating system's errors in words, and freed memory handed back to it."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

# The owner of a store may do everything; its group (the offload user) reads, and writes in two folders. Modes are set
# explicitly, because a umask that lets groups write must not open the scans to them.

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


_ADVICE: Final = {
    errno.ENOSPC: "free space on it",
    errno.EDQUOT: "free space on it",
    errno.EROFS: "mount it writable",
    errno.EACCES: "let this user read and write it",
    errno.EPERM: "let this user read and write it",
    errno.ENOTDIR: "name a folder",
    errno.EEXIST: "name a folder",
    errno.EISDIR: "name a file",
    errno.ENOENT: "connect or mount it again",
    errno.ENODEV: "connect or mount it again",
    errno.EIO: "check the card or disk, and copy what is on it to another",
    errno.EMFILE: "close other programs, or raise the limit of open files",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ELOOP: "name the folder itself, not a link to it",
    errno.ENOLCK: "put it on a file system that can lock, such as ext4",
    errno.EOPNOTSUPP: "put it on a file system that can lock, such as ext4",
}


def explain_os_error(error: OSError) -> str:
    """Return the reason and what to do, such as "(No space left on device): free space on it"."""
    return f"({error.strerror or error}): {_ADVICE.get(error.errno or 0, 'choose another folder')}"


def give_back_memory() -> None:
    """Give freed memory back, after work whose intermediate fields are large; nothing where libc cannot.

    Without it the GNU libc keeps tens of megabytes of every thread's freed fields.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)
