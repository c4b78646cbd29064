"""Making files and directories survive a power cut: fsync the file, fsync the directory, rename, fsync the parent."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path


def sync_file(path: Path) -> None:
    """Return when the file's bytes are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_directory(path: Path) -> None:
    """Return when the directory's entries are on the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace_file(path: Path, data: bytes, mode: int | None = None) -> None:
    """Put `data` in the place of a small file: a reader, and a power cut, see the old content or the new, never a part.

    mode : permissions, such as 0o600 for what is secret; what the process's mask leaves when None

    Raises
    ------
    OSError
        The file keeps its old content.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.unlink(missing_ok=True)
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode or 0o666), "wb") as stream:
            if mode is not None:
                os.fchmod(stream.fileno(), mode)
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        partial.replace(path)
    except BaseException:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    sync_directory(path.parent)


def publish_directory(partial: Path, final: Path, synced: Collection[str] = ()) -> None:
    """Make a finished temporary directory a published one, or leave no trace of it.

    Every file in it and the directory itself are on the disk before the rename, and the rename before this returns.

    synced : names of files that the caller has seen to already

    Raises
    ------
    FileExistsError
        Something is published under that name already.
    OSError
        The disk refused; `final` does not exist.
    """
    for path in sorted(partial.iterdir()):
        if path.name not in synced:
            sync_file(path)
    sync_directory(partial)
    if final.exists() or final.is_symlink():
        raise FileExistsError(f"{final} exists already")
    partial.rename(final)
    try:
        sync_directory(final.parent)
    except BaseException:
        # Not proven durable, so not published: the caller is told that it failed and must not find it later.
        final.rename(partial)
        raise


def discard(directory: Path) -> None:
    """Remove a temporary directory; what cannot be removed now is left for the next start."""
    shutil.rmtree(directory, ignore_errors=True)
