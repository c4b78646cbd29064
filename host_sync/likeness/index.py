"""The index of a library for search by likeness: one SQLite file that can be deleted at will.

Every row has a checksum: a row or file that a torn write damaged is made again from the results. What a transaction
did not finish is rolled back. A library that cannot be written gets an index in memory.
"""

from __future__ import annotations

import sqlite3
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final
from zlib import crc32

import numpy as np

from device.surface.fields import Float32Array
from host_sync.likeness.descriptor import LENGTH, VERSION

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
        """Every whole entry; damaged ones are missing."""
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
    """A connection to an index of this version, emptied when it was of another one."""
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
