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
    place = target.absolute()
    partial = place.with_name(f".{place.name}.partial")
    replaced = place.with_name(f".{place.name}.replaced")
    try:
        with _as_result_errors(target):
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
    with _as_result_errors(target):
        if not target.exists():
            nearest = next(folder for folder in target.absolute().parents if folder.exists())
            if not nearest.is_dir():
                raise ResultError(f"{target} cannot be written: {nearest} is no folder; choose another")
        elif not target.is_dir() or (any(target.iterdir()) and not (target / marker).is_file()):
            raise ResultError(
                f"{target} cannot be written: it holds something else than results; choose another folder"
            )


@contextmanager
def _as_result_errors(target: Path) -> Iterator[None]:
    """What the system refuses at `target` is said as a ResultError."""
    try:
        yield
    except ResultError:
        raise
    except OSError as error:
        raise ResultError(f"{target} cannot be written ({error.strerror or error}): free or choose another") from error
