"""Files that appear whole under their name or not at all, and none over another unasked."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import BinaryIO, TypeAlias

from device.disk_advice import explain_refusal
from host_sync.errors import ExportError

Writer: TypeAlias = Callable[[BinaryIO], None]


def check_free(paths: Iterable[Path]) -> None:
    """Nothing, if nothing stands at any of the paths.

    Raises
    ------
    ExportError
        Names the first that is taken.
    """
    for path in paths:
        if os.path.lexists(path):
            raise ExportError(f"{path}: is there already: add --overwrite or choose another folder")


def publish(path: Path, write: Writer) -> None:
    """Write under another name first, then rename; makes the folder if need be.

    Raises
    ------
    ExportError
        The folder cannot be written, or the writer refuses; what stood there stands.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with partial.open("wb") as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    except ExportError:
        raise
    except OSError as error:
        # numpy counts what a full disk did not take and names no number for it.
        reason = explain_refusal(error) if error.errno else "(the disk took no more): free space on it"
        raise ExportError(f"{path}: cannot be written {reason}") from error
