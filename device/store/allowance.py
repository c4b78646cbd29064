"""Allowance of workstations on the device: receipts of stored bundles, and an inbox of limited size.

Both folders are writable with any workstation's key. They are tidied when the store needs room, so that what
they hold does not cost a scan its place.
"""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Final

from device.bundles.layout import INBOX
from device.bundles.receipt import RECEIPTS, bundle_of

MAX_RECEIPT_BYTES: Final = 1 << 16
MAX_INBOX_BYTES: Final = 256 << 20
MAX_INBOX_ENTRIES: Final = 32

_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def tidy_shared_folders(root: Path, bundle_ids: Collection[str]) -> None:
    """Remove receipts of no stored bundle, what is no receipt, and the largest of what is beyond the inbox's limits.

    bundle_ids : of every stored scan and calibration
    """
    with suppress(OSError), _Shared(root / RECEIPTS) as receipts:
        for name in receipts.names():
            if bundle_of(name) not in bundle_ids or not 0 <= receipts.file_size(name) <= MAX_RECEIPT_BYTES:
                receipts.remove(name)
    with suppress(OSError), _Shared(root / INBOX) as inbox:
        by_size = sorted((inbox.total_size(name), name) for name in inbox.names())
        total = 0
        for number, (size, name) in enumerate(by_size):
            total += size
            if number >= MAX_INBOX_ENTRIES or total > MAX_INBOX_BYTES:
                inbox.remove(name)


class _Shared:
    """An open folder whose entries, however many, are measured and removed without following a link."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, _FOLDER)

    def __enter__(self) -> _Shared:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)

    def names(self) -> list[str]:
        with os.scandir(self._descriptor) as entries:
            return [entry.name for entry in entries]

    def file_size(self, name: str) -> int:
        """Size of a regular file, bytes; -1 for anything else."""
        with suppress(OSError):
            facts = os.stat(name, dir_fd=self._descriptor, follow_symlinks=False)
            if stat.S_ISREG(facts.st_mode):
                return facts.st_size
        return -1

    def total_size(self, name: str) -> int:
        """Return what an entry takes, bytes: all the files of a folder. Space counts where it is more than the size."""
        total = 0
        with suppress(OSError):
            facts = os.stat(name, dir_fd=self._descriptor, follow_symlinks=False)
            total = max(facts.st_size, facts.st_blocks * 512)
            if stat.S_ISDIR(facts.st_mode):
                for _, folders, files, folder in os.fwalk(name, dir_fd=self._descriptor, follow_symlinks=False):
                    for inner in (*folders, *files):
                        with suppress(OSError):
                            facts = os.stat(inner, dir_fd=folder, follow_symlinks=False)
                            total += max(facts.st_size, facts.st_blocks * 512)
        return total

    def remove(self, name: str) -> None:
        """Remove a file, link or folder as far as the system lets us."""
        try:
            os.unlink(name, dir_fd=self._descriptor)
        except (IsADirectoryError, PermissionError):
            shutil.rmtree(name, ignore_errors=True, dir_fd=self._descriptor)
        except OSError:
            pass
