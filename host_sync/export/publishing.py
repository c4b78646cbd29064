"""Atomic export of files, which replaces existing ones only on request."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import BinaryIO, TypeAlias

from device.io.atomic import atomic_file
from device.io.system import explain_os_error
from host_sync.errors import ExportError

Writer: TypeAlias = Callable[[BinaryIO], None]


def check_free(paths: Iterable[Path]) -> None:
    """Check that none of the paths exists.

    Raises
    ------
    ExportError
        One exists; the message names the first.
    """
    for path in paths:
        if os.path.lexists(path):
            raise ExportError(f"{path}: exists already: add --overwrite or choose another folder")


def check_own(paths: Iterable[Path], reserved: Collection[Path]) -> None:
    """Check that none of the paths is a file of another source; names that differ in case only are the same.

    Raises
    ------
    ExportError
        One is; the message names the first.
    """
    taken = {str(path).casefold() for path in reserved}
    for path in paths:
        if str(path).casefold() in taken:
            raise ExportError(
                f"{path}: is already the file of another source of this command: export into another folder"
            )


def publish(path: Path, write: Writer) -> None:
    """Write under a temporary name, then rename; creates the folder.

    Raises
    ------
    ExportError
        The folder cannot be written, or the writer failed; an existing file is unchanged.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as file:
            write(file)
    except ExportError:
        raise
    except OSError as error:
        # numpy reports a full disk by byte counts, without an error number.
        reason = explain_os_error(error) if error.errno else "(the disk is full): free space on it"
        raise ExportError(f"{path}: cannot be written {reason}") from error


def withdraw(path: Path) -> None:
    """Remove a file of an earlier export, if there is one.

    Raises
    ------
    ExportError
        It cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise ExportError(f"{path}: cannot be removed {explain_os_error(error)}") from error
