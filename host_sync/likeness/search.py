"""The surfaces of a library that look most like one."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final
from zlib import crc32

import numpy as np

from device.errors import DeviceError
from device.io.atomic import RESULTS
from device.surface import Float32Array
from host_sync.errors import HostError, Indescribable, LibraryError
from host_sync.library.library import Library
from host_sync.likeness.descriptor import LENGTH, VERSION, describe_result
from host_sync.results.files import RECORD_FILE
from host_sync.results.reader import read_result

# fmt: off
_FACTOR: Final = (
    54.8, 1.03, 40, 2.46, -2.6, 44.2, -2.82, -5.44, 4.43, 74.2, -6.29, 0.519, 3.17, -1.74, 47.8, 0.345, -11.3, -3.47,
    -1.18, 0.058, 30.6, 0.909, -4.38, -6.53, 2.79, 1.6, -9.22, 46.4, -3.35, -1.58, 2.37, -29.3, -4.04, -0.753, 3.2,
    74.7, -5.59, 0.122, 2.97, -0.213, -7.03, -0.47, 1.72, -0.761, 44, 0.141, -3.23, -1.86, 0.333, 0.119, -6.26, -4.7,
    0.56, 0.16, 18.3, -1.19, -5.72, -7.08, 4.01, -0.609, -10.5, -16.4, 2.52, 0.3, -18.1, 54.7, -1.96, 0.63, -1.25,
    -17.9, -1.22, -1.51, -2.08, -30, 2.43, -3.75, 1.13, 51.3, -4.94, 0.648, 2.13, 1.19, -6.16, -0.308, 1.07, 0.842,
    -7.54, -0.0305, 0.999, 3.36, 40.4, -0.0563, 0.792, 0.587, 0.199, -0.194, 0.643, -0.0273, 0.245, -0.277, -2.13,
    -2.93, 0.126, 0.139, 12.4, -1.8, -3.3, 0.621, 2.58, -2.14, -2.33, -1.01, 1.78, -2.6, 5.05, -8.02, 4.16, -2.94,
    15.9, 43, 0.814, 1.18, 0.168, 4.97, 0.442, -1.17, -0.573, 4.41, 0.287, -6.24, 0.7, -1.94, -0.767, -1.69, -3.11,
    28.8, -0.197, -0.31, 2.41, 0.0187, -0.524, 0.728, 3.23, 0.341, -0.902, 3.06, 4.79, 1, -0.957, 2.02, -4.5, -3.24,
    90.3, -1.33, 0.302, 6.58, 0.64, -1.9, 3.52, 8.29, 0.993, -2.61, 9.41, 9.18, 1.37, -2.3, 3.43, -13, 5.64, -4.41,
    59.8, -1.03, 1.14, 2.28, 0.826, -1.03, 2.8, 2.72, 0.241, -0.93, 4.64, 1.07, -0.556, -0.438, 2.34, -7.94, 2.07,
    -1.64, -9.58, 27.6, -1.59, 0.00251, 0.666, 1.94, -1.29, 0.0354, 0.199, 1.59, -0.82, -0.132, -0.537, 0.0785,
    -0.815, 6.02, -1.58, 5.03, 0.0125, -4.04, -9.64, 35.4, -3.5, 6.88, 2.22, -0.396, -3.68, 6.28, 2.8, -1.97, -3.59,
    1.62, 6.52, -1.3, -4.15, 9.37, 14.8, -0.369, 1.51, 5.18, 1.58, -19.4, 66.1, -2, 1.14, 3.72, -1.5, -2.78, -0.0982,
    3.04, -1.53, -3.52, -1.68, 3.74, 1.44, -3.68, 3.19, 6.58, -7.44, -0.455, 0.238, -0.675, -8.9, -31.6, 76, -1.01,
    -4.36, 2.07, -1.56, -1.75, -6.54, -0.553, -1.09, -2.41, -6.84, -4.82, -1.51, -1.76, -4.99, 1.4, -5.08, -0.178,
    0.123, 0.908, -0.671, -4.79, -8.86, 87.8, 0.341, 2.91, 1.25, 2.02, 0.198, 1.27, 1.8, 3.02, -0.594, -0.76, 6.2,
    2.61, -2.64, 0.114, 1.32, -2.06, -1.06, -4.33, -1.67, 1.53, 0.217, -1.84, -0.644, 19.9, -2.15, -0.797, 1.84, 1.39,
    -2.67, -1.05, 1.68, 1.36, -3.19, -0.423, 3.42, -1.45, -3.9, 0.604, 0.779, -2.83, -0.897, -2.78, -2.67, -4.45,
    -2.23, -2.49, -1.12, -3.23, 23.9, -4.48, 0.0894, 3.09, -1.88, -5.66, 0.301, 2.93, -2.61, -6.64, 1.84, 4.16, -1.79,
    -7.29, 0.637, -0.0765, -0.0474, -0.915, -3.17, -3.25, -3.24, -4.8, -5.11, -1.58, -0.592, -11.3, 32.1, -6.21, 1.56,
    1.52, 1.28, -7.48, 0.401, -0.24, 0.214, -8.77, -0.655, -2.64, 2.47, -10.8, -1.9, -2.72, -0.682, 0.0845, -0.0738,
    -1.02, -2.14, -4.38, -4.25, -1.75, -1.72, -9.44, -17.7, 36.4, -5.88, 3.95, -0.125, 1.57, -6.87, 2.79, -1.21,
    0.113, -7.99, 0.632, -1.9, 1.6, -10.5, -0.722, -1.24, 1.98, 0.888, 2.79, 2.91, 1.74, -3.28, -1.34, 0.636, -3.36,
    -4.72, -12.8, -26.6, 24.4, 0.218, 3.93, -7.48, 1.65, 0.676, 1.25, -7.52, 1.14, 0.783, -3.99, -3.48, 2.78, -1.84,
    3.47, 8.38, -1.59, 4.03, 20.7, 27.9, 20, 0.43, 5.44, 4.38, 7.84, 18.6, 17.7, 11.3, -3.36, 39.3,
)
# fmt: on
"""Lower triangle, row by row, of G: G^T times such a difference has a covariance of one."""


def whitening() -> Float32Array:
    """G: float32 array of shape (LENGTH, LENGTH); a row times G is compared figure by figure."""
    factor = np.zeros((LENGTH, LENGTH), np.float32)
    factor[np.tril_indices(LENGTH)] = _FACTOR
    return factor


KEPT_EVERY: Final = 50
"""Results after which the index is brought to the disk, so that a killed run loses little."""


@dataclass(frozen=True, slots=True)
class Alike:
    """A result that looks like the one asked for.

    distance : RMS difference of the descriptors' figures after whitening
    """

    scan: str
    folder: Path
    distance: float


@dataclass(frozen=True, slots=True)
class Answer:
    """The most alike results first, and what could not be compared.

    compared : number of results that the question was compared with
    left_out : scan and reason of every result without a descriptor
    unreadable : scan and reason of every result that cannot be read
    without_results : scans that have none
    """

    found: tuple[Alike, ...]
    compared: int
    left_out: tuple[tuple[str, str], ...]
    unreadable: tuple[tuple[str, str], ...] = ()
    without_results: tuple[str, ...] = ()


def nearest(row: Float32Array, rows: Float32Array, count: int) -> list[tuple[int, float]]:
    """Return numbers and distances of the `count` rows that are nearest, nearest first.

    row, rows : float32 arrays of shape (LENGTH,) and (N, LENGTH)
    """
    if not len(rows):
        return []
    off = (rows - row) @ whitening()
    distances = np.sqrt(np.mean(off * off, axis=1))
    return [(int(at), float(distances[at])) for at in np.argsort(distances, kind="stable")[:count]]


def alike(
    result: Path, library: Path, count: int = 5, report_progress: Callable[[str], None] = lambda _: None
) -> Answer:
    """Return the results of a library that look most like one, each scan with its newest; the index is updated first.

    result : folder of the result that is asked for; it is not among the answers
    report_progress : receives what is done at the moment

    Raises
    ------
    Indescribable
        The result asked for has no contact to compare.
    UnreadableResult
        It cannot be read.
    LibraryError
        The library cannot be read, or holds no scans.
    """
    asked = describe_result(read_result(result, samples=False))
    gaps = Gaps([], [])
    entries = updated(library, report_progress, gaps)
    if not (entries or gaps.unreadable or gaps.without_results):
        raise LibraryError(f"{library}: holds no scans: pull some first")
    own, root = result.resolve(), library.resolve()
    own_folder = own.relative_to(root).as_posix() if own.is_relative_to(root) else ""
    held = [(folder, entry.row) for folder, entry in entries.items() if entry.row is not None and folder != own_folder]
    found = nearest(asked, np.array([row for _, row in held], np.float32), count)
    return Answer(
        tuple(Alike(_scan(held[at][0]), library / held[at][0], distance) for at, distance in found),
        len(held),
        tuple((_scan(folder), entry.reason or "") for folder, entry in entries.items() if entry.row is None),
        tuple(gaps.unreadable),
        tuple(gaps.without_results),
    )


@dataclass(frozen=True, slots=True)
class Gaps:
    """Scans that an index lacks.

    unreadable : with the reason
    without_results : by name
    """

    unreadable: list[tuple[str, str]]
    without_results: list[str]


def updated(
    library: Path, report_progress: Callable[[str], None] = lambda _: None, gaps: Gaps | None = None
) -> dict[str, Entry]:
    """Return every entry of a library's index after new and changed results were described and lost ones dropped.

    Keys are folders relative to the library. Every entry is described again where the index is damaged.

    gaps : receives what has no entry
    """
    gaps = gaps or Gaps([], [])
    held_library = Library(library)
    held_library.require()
    if not (library / "scans").is_dir():
        raise LibraryError(f"{library}: holds no scans: pull some first")
    with held_library.translating("read"), LikenessIndex(library) as index:
        held = index.read()
        current: dict[str, Entry] = {}
        fresh = 0
        for folder, stamp in _newest_results(library, gaps.without_results):
            entry = held.get(folder)
            if entry is None or entry.stamp != stamp:
                report_progress(f"describing {_scan(folder)}")
                try:
                    entry = _described(library / folder, stamp)
                except (DeviceError, HostError) as error:
                    gaps.unreadable.append((_scan(folder), str(error)))
                    continue  # it is tried again in the next search
                index.put(folder, entry)
                fresh += 1
                if fresh % KEPT_EVERY == 0:
                    index.keep()
            current[folder] = entry
        for folder in held.keys() - current.keys():
            index.drop(folder)
        return current


def _described(folder: Path, stamp: str) -> Entry:
    try:
        return Entry(stamp, describe_result(read_result(folder, samples=False)), None)
    except Indescribable as error:
        return Entry(stamp, None, str(error))


def _newest_results(library: Path, without: list[str]) -> Iterator[tuple[str, str]]:
    """Yield the folder of each scan's newest result, relative to the library, and the stamp of its record.

    without : receives the scans that have no results

    Plain strings: a path object for each of ten thousand scans takes longer than to ask the disk.
    """
    root = os.fspath(library)
    for scan in sorted(one.name for one in os.scandir(f"{root}/scans") if one.is_dir() and one.name[0] != "."):
        results = f"scans/{scan}/{RESULTS}"
        try:
            with os.scandir(f"{root}/{results}") as found:
                places = [one for one in found if not one.name.startswith(".")]
        except OSError:
            places = []
        if not places:
            without.append(scan)
            continue
        newest = places[0] if len(places) == 1 else max(places, key=lambda one: one.stat().st_mtime_ns)
        try:
            facts = os.stat(f"{root}/{results}/{newest.name}/{RECORD_FILE}")  # noqa: PTH116 - see above
        except OSError:
            yield f"{results}/{newest.name}", "no record"
        else:
            yield f"{results}/{newest.name}", f"{facts.st_mtime_ns} {facts.st_size}"


def _scan(folder: str) -> str:
    return folder.split("/")[1]


# The index of a library for search by likeness: one SQLite file that can be deleted at will.
#
# Every row has a checksum: a row or file that a torn write damaged is made again from the results. What a transaction
# did not finish is rolled back. A library that cannot be written gets an index in memory.

INDEX_FILE: Final = "likeness.sqlite3"
STORED: Final = np.dtype("<f4")


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One result in the index.

    stamp : time and size of its record; another one has other heights
    row : its descriptor, float32 array of shape (LENGTH,); None when it has none
    reason : why it has none
    """

    stamp: str
    row: Float32Array | None
    reason: str | None


class LikenessIndex:
    """The descriptors of a library's results, by folder relative to the library; a context manager."""

    def __init__(self, library: Path) -> None:
        self._path = library / INDEX_FILE
        self._base = self._opened()

    def __enter__(self) -> LikenessIndex:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Keeps what was put, also after an error."""
        with suppress(sqlite3.Error):
            self._base.commit()
        self._base.close()

    def read(self) -> dict[str, Entry]:
        """Return every whole entry; damaged ones are missing."""
        try:
            rows = self._base.execute("SELECT folder, stamp, reason, row, crc FROM entry").fetchall()
        except sqlite3.DatabaseError:
            self._base.close()
            self._path.unlink(missing_ok=True)
            self._base = self._opened()
            return {}
        return {
            str(folder): Entry(str(stamp), np.frombuffer(data, STORED) if data else None, reason)
            for folder, stamp, reason, data, crc in rows
            if isinstance(data, bytes) and len(data) in (0, LENGTH * STORED.itemsize) and crc == _crc(stamp, data)
        }

    def put(self, folder: str, entry: Entry) -> None:
        """Add or replace one entry."""
        data = b"" if entry.row is None else np.asarray(entry.row, STORED).tobytes()
        with suppress(sqlite3.OperationalError):  # a full disk: the next search describes it again
            self._base.execute(
                "INSERT OR REPLACE INTO entry VALUES (?, ?, ?, ?, ?)",
                (folder, entry.stamp, entry.reason, data, _crc(entry.stamp, data)),
            )

    def drop(self, folder: str) -> None:
        """Remove one entry."""
        with suppress(sqlite3.OperationalError):
            self._base.execute("DELETE FROM entry WHERE folder = ?", (folder,))

    def keep(self) -> None:
        """Bring what was put so far to the disk."""
        with suppress(sqlite3.OperationalError):
            self._base.commit()

    def _opened(self) -> sqlite3.Connection:
        for _ in range(2):
            try:
                return _connected(str(self._path))
            except sqlite3.OperationalError:
                break  # cannot be written
            except sqlite3.DatabaseError:
                with suppress(OSError):
                    self._path.unlink(missing_ok=True)
        return _connected(":memory:")


def _crc(stamp: object, data: bytes) -> int:
    return crc32(data, crc32(str(stamp).encode()))


def _connected(path: str) -> sqlite3.Connection:
    """Return a connection to an index of this version, emptied when it was of another one."""
    base = sqlite3.connect(path)
    try:
        (version,) = base.execute("PRAGMA user_version").fetchone()
        if version != VERSION:
            base.execute("DROP TABLE IF EXISTS entry")
            base.execute(f"PRAGMA user_version = {VERSION}")
        base.execute(
            "CREATE TABLE IF NOT EXISTS entry (folder TEXT PRIMARY KEY, stamp TEXT, reason TEXT, row BLOB, crc INTEGER)"
        )
        base.commit()
    except sqlite3.Error:
        base.close()
        raise
    return base
