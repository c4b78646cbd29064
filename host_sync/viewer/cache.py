"""The viewer's cache: pyramids, thumbnails and differences in a folder that can be deleted at any time.

Everything in it can be computed again; the folders used longest ago are removed above a size limit.
"""

from __future__ import annotations

import atexit
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from threading import Lock
from typing import Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array
from host_sync.errors import ViewError
from host_sync.kernels.cache import user_cache
from host_sync.viewer.entry import Entry, Heights

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


# Pyramid of levels for the page: slopes and heights averaged 2 × 2 per level.
#
# Slopes are averaged, not colours, so that a small relief does not sparkle. Means are taken over valid pixels; where
# none is valid, heights come from the level above, so that holes have no walls.
#
# A level is (rows, columns, 4) of half floats - p, q, and the height as a large and a small part whose sum has 22 bits
# - and (rows, columns) of bytes, the fraction of valid pixels. Sizes are padded to a multiple of the coarsest cell, so
# that each level lies exactly on the one below.

MIN_LEVEL_PX: Final = 96
MAX_LEVELS: Final = 8
MAX_SLOPE: Final = 1e4
"""Slopes are clipped here; half floats end at 65504."""

Half: TypeAlias = NDArray[np.float16]
Bytes: TypeAlias = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One level: half floats of shape (h, w, 4) and bytes of shape (h, w)."""

    surface: Half
    valid: Bytes


@dataclass(frozen=True, slots=True, eq=False)
class Means:
    """Means over cells: float32 arrays (h, w); p, q, z are 0 where the weight is 0."""

    p: Float32Array
    q: Float32Array
    z_um: Float32Array
    weight: Float32Array


def level_count(shape: tuple[int, int]) -> int:
    """Return the number of levels of a height map, including level 0."""
    count = 1
    while count < MAX_LEVELS and max(shape) >> (count - 1) > MIN_LEVEL_PX:
        count += 1
    return count


def padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the size of level 0: (H, W) padded to multiples of the coarsest level's cell."""
    cell = 1 << (level_count(shape) - 1)
    return -(-shape[0] // cell) * cell, -(-shape[1] // cell) * cell


def coarse_levels(z_um: Float32Array, pitch_um: float) -> list[Level]:
    """Return levels 1 and up of a height map, fine to coarse."""
    means = [_first_means(z_um, pitch_um)]
    for _ in range(level_count(z_um.shape) - 2):
        means.append(_halved(means[-1]))
    filled: Float32Array | None = None
    levels = []
    for mean in reversed(means[: level_count(z_um.shape) - 1]):
        filled = _filled(mean.z_um, mean.weight > 0, filled)
        levels.append(_level(mean, filled))
    return levels[::-1]


def finest_rows(z_um: Float32Array, pitch_um: float, above: Level | None, first: int, last: int) -> Level:
    """Return rows `first` to `last` of level 0, both even.

    above : level 1, which gives heights inside holes
    """
    p, q, weight = _slopes(z_um, pitch_um, first, last)
    shape = (last - first, padded_shape(z_um.shape)[1])
    inside = z_um[first:last]
    z = _padded(inside, shape)
    coarser = None
    if above is not None:
        coarse = above.surface[first // 2 : last // 2]
        coarser = coarse[..., 2].astype(np.float32) + coarse[..., 3].astype(np.float32)
    filled = _filled(np.nan_to_num(z), np.isfinite(z), coarser)
    return _level(Means(_padded(p, shape, 0.0), _padded(q, shape, 0.0), z, _padded(weight, shape, 0.0)), filled)


def _bands(rows: int, step: int = 512) -> Iterator[tuple[int, int]]:
    return ((first, min(first + step, rows)) for first in range(0, rows, step))


def _first_means(z_um: Float32Array, pitch_um: float) -> Means:
    """Return the level 1, computed in bands to save memory."""
    rows, columns = padded_shape(z_um.shape)
    half = (max(rows // 2, 1), max(columns // 2, 1))
    found = Means(*(np.zeros(half, np.float32) for _ in range(4)))
    for first, last in _bands(rows):
        shape = (last - first, columns)
        p, q, weight = _slopes(z_um, pitch_um, first, last)
        inside = np.where(weight > 0, z_um[first:last], np.float32(0.0)).astype(np.float32)
        fine = Means(*(_padded(part, shape, 0.0) for part in (p, q, inside, weight)))
        coarse = _halved(fine)
        there = slice(first // 2, last // 2)
        for name in ("p", "q", "z_um", "weight"):
            getattr(found, name)[there] = getattr(coarse, name)
    return found


def _slopes(
    z_um: Float32Array, pitch_um: float, first: int, last: int
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """p, q and weight (1 where both are finite) of some rows of a height map; fewer rows at its end."""
    rows = z_um.shape[0]
    first, last = min(first, rows), min(last, rows)
    top, bottom = max(first - 1, 0), min(last + 1, rows)
    if bottom - top < 2:
        top = max(bottom - 2, 0)
    if first == last:
        empty = np.zeros((0, z_um.shape[1]), np.float32)
        return empty, empty, empty
    q, p = np.gradient(z_um[top:bottom] / np.float32(pitch_um))
    kept = slice(first - top, last - top)
    p, q = p[kept], q[kept]
    # A central difference ignores its own pixel.
    known = np.isfinite(p) & np.isfinite(q) & np.isfinite(z_um[first:last])
    bounded = (np.where(known, np.clip(slope, -MAX_SLOPE, MAX_SLOPE), np.float32(0.0)) for slope in (p, q))
    p, q = (np.asarray(slope, np.float32) for slope in bounded)
    return p, q, known.astype(np.float32)


def _halved(fine: Means) -> Means:
    """Return means over 2 × 2 cells, weighted."""
    size = (max(fine.weight.shape[1] // 2, 1), max(fine.weight.shape[0] // 2, 1))

    def mean(values: Float32Array) -> Float32Array:
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)

    weight = mean(fine.weight)
    share = np.maximum(weight, np.float32(1e-6))
    p, q, z = (np.asarray(mean(part * fine.weight) / share, np.float32) for part in (fine.p, fine.q, fine.z_um))
    return Means(p, q, z, weight)


def _filled(z_um: Float32Array, known: NDArray[np.bool_], coarser: Float32Array | None) -> Float32Array:
    """Return heights, from the coarser level where invalid."""
    if known.all():
        return z_um
    if coarser is None:
        rest = float(z_um[known].mean()) if known.any() else 0.0
        return np.where(known, z_um, np.float32(rest))
    size = (z_um.shape[1], z_um.shape[0])
    return np.where(known, z_um, cv2.resize(coarser, size, interpolation=cv2.INTER_LINEAR))


def _padded(values: Float32Array, shape: tuple[int, int], blank: float = np.nan) -> Float32Array:
    if values.shape == shape:
        return np.asarray(values, np.float32)
    padded = np.full(shape, blank, np.float32)
    padded[: values.shape[0], : values.shape[1]] = values
    return padded


def _level(means: Means, z_um: Float32Array) -> Level:
    surface = np.empty((*z_um.shape, 4), np.float32)
    surface[..., 0], surface[..., 1] = means.p, means.q
    surface[..., 2] = np.clip(z_um, -65000.0, 65000.0).astype(np.float16)
    surface[..., 3] = np.clip(z_um - surface[..., 2], -32.0, 32.0)
    # Conversion of subnormal half floats takes ten times as long; nothing so small is seen.
    surface *= np.abs(surface) >= np.finfo(np.float16).smallest_normal
    return Level(surface.astype(np.float16), np.round(means.weight * 255.0).astype(np.uint8))
