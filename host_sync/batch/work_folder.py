"""The folder of files that the processes of one job share: gone with the job, or when the next one starts.

It lies in the library, which is on a disk: the system's folder for temporary files may be memory. The job holds the
folder's lock, which the system ends with the process however that ends; a folder that nobody holds is abandoned.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Final

from device.io.atomic import remove_tree_quietly
from device.io.lock import FolderLocked, locked_directory

PREFIX: Final = ".retrosync-"


@contextmanager
def work_folder(place: Path) -> Iterator[Path]:
    """A new folder in `place`, removed at the end; what killed jobs of this computer left there is removed first.

    Raises
    ------
    OSError
        None can be made there.
    """
    remove_abandoned(place)
    with ExitStack() as stack:
        yield _held_folder(place, stack)


def remove_abandoned(place: Path) -> None:
    """Remove folders of jobs of this computer that no longer run; those that cannot be removed stay.

    The lock of a job on another computer may not be seen from here, so that its folder is left alone.
    """
    for folder in place.glob(f"{_prefix()}*"):
        with suppress(OSError), locked_directory(folder, wait=False):
            remove_tree_quietly(folder)


def _held_folder(place: Path, stack: ExitStack) -> Path:
    """A new folder whose lock is held, and which is removed, with the stack."""
    while True:
        with ExitStack() as attempt:
            folder = Path(mkdtemp(prefix=_prefix(), dir=place))
            attempt.callback(remove_tree_quietly, folder)
            try:
                attempt.enter_context(locked_directory(folder, wait=False))
            except (FolderLocked, FileNotFoundError):
                continue  # another job that starts took it for abandoned before it was locked
            if folder.is_dir():
                stack.push(attempt.pop_all())
                return folder


def _prefix() -> str:
    """Return what the folders of this computer's jobs are called, but for the end of the name."""
    return f"{PREFIX}{re.sub('[^A-Za-z0-9]+', '_', socket.gethostname())}-"
