"""What to do about a disk's refusal, in a few words that end the sentence."""

from __future__ import annotations

import errno
from typing import Final

_ADVICE: Final = {
    errno.ENOSPC: "free space on it",
    errno.EDQUOT: "free space on it",
    errno.EROFS: "mount it so that it can be written",
    errno.EACCES: "let this user read and write it",
    errno.EPERM: "let this user read and write it",
    errno.ENOTDIR: "name a folder",
    errno.EEXIST: "name a folder",
    errno.EISDIR: "name a file",
    errno.ENOENT: "connect or mount it again",
    errno.ENODEV: "connect or mount it again",
    errno.EIO: "check the card or disk, and take what is on it to another",
    errno.ENAMETOOLONG: "name a shorter one",
    errno.ELOOP: "name the folder itself, not a link to it",
}


def explain_refusal(error: OSError) -> str:
    """The system's reason and what to do, such as "(No space left on device): free space on it"."""
    return f"({error.strerror or error}): {_ADVICE.get(error.errno or 0, 'name another folder')}"
