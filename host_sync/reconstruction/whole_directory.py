"""A directory of results that appears whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from host_sync.errors import ResultError


@contextmanager
def whole_directory(target: Path) -> Iterator[Path]:
    """A temporary directory that takes the place of `target` when the block ends well, and vanishes otherwise.

    Raises
    ------
    ResultError
        The place cannot be written.
    """
    partial = target.with_name(f".{target.name}.partial")
    replaced = target.with_name(f".{target.name}.replaced")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        yield partial
        shutil.rmtree(replaced, ignore_errors=True)
        if target.exists():
            target.rename(replaced)
        partial.rename(target)
    except OSError as error:
        raise ResultError(f"{target} cannot be written ({error.strerror or error}): free or choose another") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(replaced, ignore_errors=True)
