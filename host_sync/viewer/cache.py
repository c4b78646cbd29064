"""The viewer's cache: pyramids, thumbnails and differences in a folder that can be deleted at any time.

Everything in it can be computed again; the folders used longest ago are removed above a size limit.
"""

from __future__ import annotations

import atexit
import os
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import mkdtemp
from threading import Lock
from typing import Final

import numpy as np

from host_sync.errors import ViewError
from host_sync.kernels.cache import user_cache
from host_sync.viewer.entry import Entry, Heights
from host_sync.viewer.pyramid import Level, coarse_levels, finest_rows, level_count, padded_shape

FORM: Final = 1
"""Version of the stored files."""

MAX_BYTES: Final = 4_000_000_000
_UNFINISHED: Final = ".unfinished-"
_OWN: Final = re.compile(r"[0-9]+-[0-9a-f]{32}")


def default_cache() -> Path:
    """Return the user's cache folder; where that cannot be written, one that is removed when the program ends."""
    home = user_cache()
    if home is not None:
        with suppress(OSError):
            (home / "viewer").mkdir(parents=True, exist_ok=True)
        if os.access(home / "viewer", os.W_OK | os.X_OK):
            return home / "viewer"
    folder = mkdtemp(prefix="retrograph-view-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


class Cache:
    """Levels and thumbnails of entries, computed at the first request, one at a time.

    Parameters
    ----------
    folder : created with the first file
    max_bytes : above this, the folders used longest ago are removed
    """

    def __init__(self, folder: Path, heights: Heights, max_bytes: int = MAX_BYTES) -> None:
        self._folder = folder
        self._heights = heights
        self._max_bytes = max_bytes
        self._making = Lock()

    def level(self, entry: Entry, page: int, level: int, first: int, last: int) -> Level:
        """Return rows `first` to `last` of a level; level 0 is never stored.

        Raises
        ------
        ViewError
            There are no such rows.
        """
        rows = padded_shape(entry.shape)[0] >> level if 0 <= level < level_count(entry.shape) else 0
        if not 0 <= first < last <= rows or (level == 0 and (first % 2 or last % 2) and level_count(entry.shape) > 1):
            raise ViewError(f"{entry.title}: has no such rows at level {level}: load the page again")
        if level == 0:
            z_um = self._heights.read(entry, page)
            above = self._stored(entry, page, 1) if level_count(entry.shape) > 1 else None
            return finest_rows(z_um, entry.pitch_um, above, first, last)
        found = self._stored(entry, page, level)
        return Level(found.surface[first:last], found.valid[first:last])

    def file(self, entry: Entry, name: str, make: Callable[[], bytes]) -> bytes:
        """Return a small file of an entry, made if missing."""
        folder = self.folder(entry.stamp())
        path = folder / name
        try:
            return path.read_bytes()
        except OSError:
            data = make()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            partial = Path(mkdtemp(prefix=_UNFINISHED, dir=folder)) / name
            partial.write_bytes(data)
            partial.replace(path)
            partial.parent.rmdir()
        except OSError:
            return data  # without a cache, only time is lost
        return data

    def folder(self, stamp: str) -> Path:
        """Return the folder of the files of one height map."""
        return self._folder / f"{FORM}-{stamp}"

    def _stored(self, entry: Entry, page: int, level: int) -> Level:
        stamp = entry.stamp()
        folder = self.folder(stamp) / f"levels-{page}"
        with self._making:
            found = _open(folder, entry, level)
            if found is None:
                levels = coarse_levels(self._heights.read(entry, page), entry.pitch_um)
                if entry.kind == "video" or not self._store(folder, levels):
                    return levels[level - 1]
                found = _open(folder, entry, level) or levels[level - 1]
        return found

    def _store(self, folder: Path, levels: list[Level]) -> bool:
        """Store levels in a folder; False if the disk refuses."""
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            partial = Path(mkdtemp(prefix=_UNFINISHED, dir=folder.parent))
            for number, level in enumerate(levels, start=1):
                (partial / f"surface-{number}.f16").write_bytes(level.surface.tobytes())
                (partial / f"valid-{number}.u8").write_bytes(level.valid.tobytes())
            shutil.rmtree(folder, ignore_errors=True)
            partial.rename(folder)
            self._prune(keep=folder.parent)
        except OSError:
            return False
        return True

    def _prune(self, keep: Path) -> None:
        """Delete the cache's own folders used longest ago, except `keep`, until the rest is small enough."""
        folders = [one for one in self._folder.iterdir() if _OWN.fullmatch(one.name) and one.is_dir()]
        sizes = {one: sum(file.stat().st_size for file in one.rglob("*") if file.is_file()) for one in folders}
        used = {one: one.stat().st_mtime_ns for one in folders}
        total = sum(sizes.values())
        for one in sorted(folders, key=used.__getitem__):
            if total <= self._max_bytes:
                break
            if one != keep:
                shutil.rmtree(one, ignore_errors=True)
                total -= sizes[one]


def _open(folder: Path, entry: Entry, level: int) -> Level | None:
    """Return a stored level as memory-mapped arrays; None when it is missing or incomplete."""
    rows, columns = (size >> level for size in padded_shape(entry.shape))
    try:
        surface = np.memmap(folder / f"surface-{level}.f16", np.float16, "r")
        valid = np.memmap(folder / f"valid-{level}.u8", np.uint8, "r")
        found = Level(surface.reshape(rows, columns, 4), valid.reshape(rows, columns))
    except (OSError, ValueError):
        return None
    with suppress(OSError):
        os.utime(folder.parent)  # time of last use
    return found
