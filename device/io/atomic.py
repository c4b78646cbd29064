"""Files and folders that appear whole or not at all, also after a power cut.

The order is always: write under a hidden name, fsync the file, fsync its folder, rename, fsync the parent folder.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

from device.errors import OutputError
from device.io.folder import NO_FOLLOW, OPENS_FOLDERS, sync_descriptor
from device.io.lock import FolderLocked, locked_directory
from device.io.system import explain_os_error

RESULTS: Final = "results"
"""Folder of a scan for its results, one folder each."""


def sync_file(path: Path) -> None:
    """Return when the file's bytes are on the disk."""
    # Windows flushes what is open for writing only.
    _sync(path, (os.O_RDONLY if OPENS_FOLDERS else os.O_RDWR) | NO_FOLLOW)


def sync_directory(path: Path) -> None:
    """Return when the directory's entries are on the disk; at once where the system does not open folders (Windows)."""
    if OPENS_FOLDERS:
        _sync(path, os.O_RDONLY | os.O_DIRECTORY)


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        sync_descriptor(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def atomic_file(path: Path, mode: int | None = None) -> Iterator[BinaryIO]:
    """A stream whose content replaces `path` when the block ends well; otherwise the old file stays.

    mode : permissions, such as 0o600 for secrets; the process's umask decides when None
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.unlink(missing_ok=True)
        # Not os.fdopen: some writers look for the stream's name.
        with open(partial, "xb", opener=lambda name, flags: os.open(name, flags, mode or 0o666)) as stream:
            if mode is not None and OPENS_FOLDERS:
                os.fchmod(stream.fileno(), mode)
            yield stream
            stream.flush()
            sync_descriptor(stream.fileno())
        partial.replace(path)
    except BaseException:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    sync_directory(path.parent)


def replace_file(path: Path, data: bytes, mode: int | None = None) -> None:
    """Replace a small file by `data` in one step; `mode` as for `atomic_file`.

    Raises
    ------
    OSError
        The disk refused; the file keeps its old content.
    """
    with atomic_file(path, mode) as stream:
        stream.write(data)


def write_output(path: Path, data: bytes) -> None:
    """Replace a file that the user asked for.

    Raises
    ------
    OutputError
        The place cannot be written; the old file stays.
    """
    try:
        replace_file(path, data)
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror or error}): choose another place") from error


def check_output(path: Path, *, makes_folders: bool = False) -> None:
    """Refuse a place that no file can be written to, before minutes of work.

    makes_folders : the writer makes the folders that are missing

    Raises
    ------
    OutputError
        Names the place.
    """
    try:
        is_folder = path.is_dir()
        nearest = next(folder for folder in path.absolute().parents if folder.exists())
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror or error}): choose another place") from error
    if is_folder:
        raise OutputError(f"{path} cannot be written: it is a folder; name a file")
    if not nearest.is_dir():
        raise OutputError(f"{path} cannot be written: {nearest} is no folder; choose another place")
    if not makes_folders and nearest != path.absolute().parent:
        raise OutputError(f"{path} cannot be written: there is no folder {path.parent}; make it, or choose another")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise OutputError(f"{path} cannot be written: {nearest} is not yours to write; choose another place")


def publish_directory(partial: Path, final: Path, synced: Collection[str] = ()) -> None:
    """Rename a finished temporary directory to its final name, durably, or leave no trace of it.

    synced : names of files that the caller has synced already

    Raises
    ------
    FileExistsError
        `final` exists already.
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
        # Not proven durable: the caller reports a failure, so the directory must not be found later.
        final.rename(partial)
        raise


@contextmanager
def atomic_directory(target: Path, marker: str) -> Iterator[Path]:
    """A temporary directory that replaces `target` when the block ends well, and is removed otherwise.

    marker : file that identifies a directory of results; only such a directory, or an empty one, is replaced

    Raises
    ------
    OutputError
        The place cannot be written, holds something else, or is being written by another program.
    """
    check_replaceable(target, marker)
    place = target.absolute()
    replaced = place.with_name(f".{place.name}.replaced")
    with _as_output_errors(target), _held_directory(place.with_name(f".{place.name}.partial"), target) as partial:
        if replaced.is_dir() and not target.exists():
            replaced.rename(target)  # an earlier run ended between its two renames
        _remove_abandoned(place.parent)
        yield partial
        remove_tree_quietly(replaced)
        if target.exists():
            target.rename(replaced)
        partial.rename(target)
        remove_tree_quietly(replaced)


@contextmanager
def _held_directory(partial: Path, target: Path) -> Iterator[Path]:
    """A new directory whose lock this program holds; it is removed after an error. What a killed run left is replaced.

    Raises
    ------
    OutputError
        Another program holds it: what both write for `target` would get mixed up.
    """
    taken = f"{target} cannot be written: another program is writing it; repeat when that has ended"
    with ExitStack() as stack:
        try:
            with suppress(FileNotFoundError), locked_directory(partial, wait=False):
                remove_tree_quietly(partial)
            partial.mkdir(parents=True)
            stack.enter_context(locked_directory(partial, wait=False))
        except (FolderLocked, FileExistsError) as error:
            raise OutputError(taken) from error
        try:
            yield partial
        except BaseException:
            remove_tree_quietly(partial)
            raise


def _remove_abandoned(folder: Path) -> None:
    """In a scan's folder of results, remove what killed runs left under other names and no running one holds."""
    if folder.name == RESULTS:
        for partial in folder.glob(".*.partial"):
            with suppress(OSError), locked_directory(partial, wait=False):
                remove_tree_quietly(partial)


def check_replaceable(target: Path, marker: str) -> None:
    """Refuse a place that cannot take a directory, or holds something that must not be replaced.

    Raises
    ------
    OutputError
        Names the place.
    """
    if not target.absolute().name:
        raise OutputError(f"{target} cannot be written: it is not a dedicated folder; choose another")
    with _as_output_errors(target):
        if not target.exists():
            nearest = next(folder for folder in target.absolute().parents if folder.exists())
            if not nearest.is_dir():
                raise OutputError(f"{target} cannot be written: {nearest} is no folder; choose another")
        elif not target.is_dir() or (any(target.iterdir()) and not (target / marker).is_file()):
            raise OutputError(f"{target} cannot be written: it holds other files than results; choose another folder")


def remove_tree_quietly(directory: Path) -> None:
    """Remove a temporary directory; what cannot be removed now is left for the next start."""
    shutil.rmtree(directory, ignore_errors=True)


@contextmanager
def _as_output_errors(target: Path) -> Iterator[None]:
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{target} cannot be written {explain_os_error(error)}") from error
