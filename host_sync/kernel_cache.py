"""Where compiled kernels stay between runs: a folder for every state of the sources.

Why not beside the sources, where numba puts them: it compiles a kernel anew when the file that it stands in has
changed, but not when one that it calls in another file has. After an upgrade old and new code would run together, and
heights be wrong without a word.

A state is known by the names, sizes and times of the package's files: to read them all takes several times as long, and
an upgrade leaves no file with all three as they were.
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
"""numba's own; who sets it decides."""

KEPT_S: Final = 30 * 86400.0
"""A folder that was not used for so long is removed."""


def keep_kernels_apart(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let numba, which must not be loaded yet, keep compiled kernels in the folder of this state of the sources."""
    home = cache_home(environment)
    if home is not None and not environment.get(SETTING):
        environment[SETTING] = str(home / state_of(Path(__file__).parent, Path(__file__).parent.parent / "device"))


def cache_home(environment: Mapping[str, str] = os.environ) -> Path | None:
    """The folder that holds one folder for each state; None where the user has no home."""
    named = environment.get("XDG_CACHE_HOME")
    try:
        return (Path(named) if named else Path.home() / ".cache") / "retrograph" / "kernels"
    except RuntimeError:
        return None


def state_of(*packages: Path) -> str:
    """A name for the state of the sources in these folders."""
    digest = blake2b(digest_size=10)
    for package in packages:
        for line in sorted(_stamps(str(package))):
            digest.update(line.encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


def forget_unused_states(environment: Mapping[str, str] = os.environ, now_s: float | None = None) -> None:
    """Note that this state is in use, and remove those that have not been for a month."""
    own, home = Path(environment.get(SETTING, "")), cache_home(environment)
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
