"""Where compiled kernels are cached between runs: one folder per state of the source files.

numba's default is beside the sources. It recompiles a kernel when its own file has changed, but not when a kernel that
it calls in another file has: after an upgrade, old and new code would run together and heights would be wrong without
notice.

A state is identified by names, sizes and times of the package's files. Reading them all would take several times as
long, and an upgrade changes at least one of the three.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator, Mapping, MutableMapping
from hashlib import blake2b
from pathlib import Path
from typing import Final

SETTING: Final = "NUMBA_CACHE_DIR"
"""numba's own variable; when the user sets it, it is not changed."""

PACKAGES: Final = tuple(Path(__file__).parents[2] / name for name in ("host_sync", "device"))
"""Folders whose source files make up a state: kernels of the workstation call functions of both."""

KEPT_S: Final = 30 * 86400.0
"""Folders unused for this long are removed."""


def configure_cache(environment: MutableMapping[str, str] = os.environ) -> None:
    """Point numba, which must not be imported yet, to the cache folder of this state of the sources."""
    if not environment.get(SETTING) and (home := cache_home()):
        environment[SETTING] = str(home / state_of(*PACKAGES))


def holds_kernels(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the cache folder of this state holds compiled kernels of an earlier run."""
    folder = environment.get(SETTING)
    return folder is not None and any(Path(folder).glob("*/*.nbi"))


def cache_home() -> Path | None:
    """Folder with one subfolder per state; None where the user has no home."""
    import platformdirs  # here, because commands that compile nothing do not need it

    try:
        home = platformdirs.user_cache_path("retrograph", appauthor=False) / "kernels"
    except RuntimeError:
        return None
    return home if home.is_absolute() else None


def state_of(*packages: Path) -> str:
    """Name for the state of the source files in these folders."""
    digest = blake2b(digest_size=10)
    for package in packages:
        for line in sorted(_stamps(str(package))):
            digest.update(line.encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


def prune_cache(environment: Mapping[str, str] = os.environ, now_s: float | None = None) -> None:
    """Mark this state as used, and remove states unused for a month."""
    own, home = Path(environment.get(SETTING, "")), cache_home()
    if home is None or own.parent != home or not own.is_dir():
        return
    os.utime(own)
    oldest_s = (time.time() if now_s is None else now_s) - KEPT_S
    for folder in home.iterdir():
        if folder != own and folder.stat().st_mtime < oldest_s:
            shutil.rmtree(folder, ignore_errors=True)


def _stamps(folder: str) -> Iterator[str]:
    """Path, size and time of each source file below a folder."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(".py"):
                facts = entry.stat()
                yield f"{entry.path}\0{facts.st_size}\0{facts.st_mtime_ns}\n"
            elif entry.is_dir() and entry.name != "__pycache__":
                yield from _stamps(entry.path)
