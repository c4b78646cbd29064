"""A directory of results that appears whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from host_sync.errors import ResultError


@contextmanager
def whole_directory(target: Path, marker: str) -> Iterator[Path]:
    """A temporary directory that takes the place of `target` when the block ends well, and vanishes otherwise.

    marker : name of the file by which a directory of results is known; only such a one, or an empty one, is replaced

    Raises
    ------
    ResultError
        The place cannot be written, or holds something else.
    """
    check_replaceable(target, marker)
    target = target.absolute()
    partial = target.with_name(f".{target.name}.partial")
    replaced = target.with_name(f".{target.name}.replaced")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        if replaced.is_dir() and not target.exists():
            replaced.rename(target)  # an earlier run ended between its two renames
        partial.mkdir(parents=True)
        yield partial
        shutil.rmtree(replaced, ignore_errors=True)
        if target.exists():
            target.rename(replaced)
        partial.rename(target)
        shutil.rmtree(replaced, ignore_errors=True)
    except OSError as error:
        if isinstance(error, ResultError):
            raise
        raise ResultError(f"{target} cannot be written ({error.strerror or error}): free or choose another") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def check_replaceable(target: Path, marker: str) -> None:
    """Refuse a place that cannot take a directory, or holds what nobody asked to be replaced.

    Raises
    ------
    ResultError
        Names the place.
    """
    if not target.absolute().name:
        raise ResultError(f"{target} cannot be written: it is no folder of its own; choose another")
    try:
        if not target.exists():
            nearest = next(folder for folder in target.absolute().parents if folder.exists())
            if not nearest.is_dir():
                raise ResultError(f"{target} cannot be written: {nearest} is no folder; choose another")
            return
        foreign = not target.is_dir() or (any(target.iterdir()) and not (target / marker).is_file())
    except OSError as error:
        if isinstance(error, ResultError):
            raise
        raise ResultError(f"{target} cannot be written ({error.strerror or error}): choose another") from error
    if foreign:
        raise ResultError(f"{target} cannot be written: it holds something else than results; choose another folder")
