"""A file that appears whole or not at all."""

from __future__ import annotations

from pathlib import Path

from host_sync.errors import ResultError


def write_whole(path: Path, data: bytes) -> None:
    """Write a file under another name first, then let it take the place of what stood there.

    Raises
    ------
    ResultError
        The place cannot be written; what stood there stands.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        try:
            partial.write_bytes(data)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise ResultError(f"{path} cannot be written ({error.strerror or error}): choose another place") from error
