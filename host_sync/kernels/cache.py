"""The folder in which compiled kernels are cached between runs (see `host_sync.kernels.jit`)."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator, Mapping, MutableMapping
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Final

SETTING: Final = "NUMBA_CACHE_DIR"
"""numba's own variable; when the user sets it, it is not changed."""

USER_CACHE: Final = "RETROGRAPH_CACHE"
"""Environment variable that names another folder for all that is kept; when it is empty, kernels alone are."""

SUFFIX: Final = ".kernel"

PACKAGES: Final = tuple(Path(__file__).parents[2] / name for name in ("host_sync", "device"))
"""Folders whose source files make up a state: calibrations are made by the code of both."""

KEPT_S: Final = 30 * 86400.0
"""What is unused for this long is removed."""


def configure_cache(environment: MutableMapping[str, str] = os.environ) -> None:
    """Point numba, which must not be imported yet, to the user's cache folder."""
    if not environment.get(SETTING) and (home := cache_home(environment)):
        environment[SETTING] = str(home)


def holds_kernels(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether the cache folder holds kernels that an earlier run compiled."""
    folder = environment.get(SETTING) or cache_home(environment)
    return folder is not None and any(Path(folder).glob(f"*{SUFFIX}"))


def user_cache(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return the user's cache folder, or that of `USER_CACHE`; None where that is empty or the user has no home."""
    return None if environment.get(USER_CACHE) == "" else _cache_folder(environment)


def _cache_folder(environment: Mapping[str, str]) -> Path | None:
    import platformdirs  # here, because commands that compile nothing do not need it

    if named := environment.get(USER_CACHE):
        return Path(named).absolute()
    try:
        home = platformdirs.user_cache_path("retrograph", appauthor=False)
    except RuntimeError:
        return None
    return home if home.is_absolute() else None


def cache_home(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return the folder of compiled kernels, which are kept in any case; None where the user has no home."""
    home = _cache_folder(environment)
    return home and home / "kernels"


def state_of(*packages: Path) -> str:
    """Name for the state of the source files in these folders."""
    digest = blake2b(digest_size=10)
    for package in packages:
        for line in sorted(_stamps(str(package))):
            digest.update(line.encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


def prune_cache(environment: Mapping[str, str] = os.environ, now_s: float | None = None) -> None:
    """Remove kernels of the user's folder that no run has loaded for a month, and what other versions left there."""
    home = cache_home(environment)
    if home is None or Path(environment.get(SETTING) or home) != home or not home.is_dir():
        return
    oldest_s = (time.time() if now_s is None else now_s) - KEPT_S
    for entry in home.iterdir():
        with suppress(FileNotFoundError):  # another run removes it, or is renaming it
            if entry.stat().st_mtime < oldest_s:
                shutil.rmtree(entry, ignore_errors=True) if entry.is_dir() else entry.unlink()


def _stamps(folder: str) -> Iterator[str]:
    """Yield the path, size and time of each source file below a folder."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(".py"):
                facts = entry.stat()
                yield f"{entry.path}\0{facts.st_size}\0{facts.st_mtime_ns}\n"
            elif entry.is_dir() and entry.name != "__pycache__":
                yield from _stamps(entry.path)
