"""The operating system's errors in a few words that end a sentence."""

from __future__ import annotations

import errno
from typing import Final

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
