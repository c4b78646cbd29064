"""What scans are fetched from: a folder, a card, or a device over the network, all behind one Protocol.

A place is a path below the store with "/" between its parts, such as "scans/<id>/raw.tif".
"""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Protocol

from device.bundle_layout import BundleKind


class Source(Protocol):
    """Somewhere that published bundles can be read, and receipts and calibrations can be left."""

    @property
    def name(self) -> str:
        """What people call it, for messages."""
        ...

    def bundle_ids(self, kind: BundleKind) -> list[str]:
        """Ids of the published bundles, sorted.

        Raises
        ------
        SourceError
            It cannot be read.
        """
        ...

    def names(self, folder: str) -> list[str]:
        """Names in a folder of the store, sorted; none when there is no such folder. Errors as for `bundle_ids`."""
        ...

    def blocks(self, place: str, offset_bytes: int = 0) -> Generator[bytes, None, None]:
        """A file's bytes from an offset on, in blocks of at most a megabyte.

        Raises
        ------
        SourceError
            There is no such regular file, or it may not be read.
        SourceLost
            The source went away; what was yielded is good.
        """
        ...

    def write(self, place: str, data: bytes | Path) -> None:
        """Put a file there, whole or not at all: these bytes, or what a file of ours holds.

        Raises
        ------
        SourceError
            The source is read-only, full or gone.
        """
        ...

    def make_folder(self, place: str) -> None:
        """Make a folder; one that is there is kept. Errors as for `write`."""
        ...

    def rename(self, place: str, new_place: str) -> None:
        """Rename a file or folder. Errors as for `write`."""
        ...

    def clock_offset_s(self) -> float | None:
        """How far the source's clock is ahead of ours, s; None when it has none of its own or keeps it to itself."""
        ...
