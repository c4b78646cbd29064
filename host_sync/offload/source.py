"""Sources of bundles: a folder, a card, or a device over the network, behind one Protocol.

A place is a path below the store with "/" between its parts, such as "scans/<id>/raw.tif". Nothing that a source says
is trusted.
"""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Final, Protocol

from device.bundles.layout import BundleKind, BundleNames

PATIENCE_S: Final = 8.0
"""Without any data, after which a device counts as gone."""


class Source(Protocol):
    """A store whose published bundles can be read, and where receipts and calibrations can be left."""

    @property
    def name(self) -> str:
        """The source's name in messages."""
        ...

    def bundle_names(self, kind: BundleKind) -> BundleNames:
        """Ids of the published bundles, and entries that cannot be bundles.

        Raises
        ------
        SourceError
            It cannot be read.
        """
        ...

    def names(self, folder: str) -> list[str]:
        """Names in a folder of the store, sorted; none when there is no such folder.

        Raises
        ------
        SourceError
            It cannot be read, or is no folder.
        """
        ...

    def blocks(self, place: str, offset_bytes: int = 0) -> Generator[bytes, None, None]:
        """A file's bytes from an offset, in blocks of at most a megabyte.

        Raises
        ------
        SourceError
            There is no such regular file, or it may not be read.
        SourceLost
            The source went away; what was yielded is good.
        """
        ...

    def write(self, place: str, data: bytes | Path) -> None:
        """Put a file there in one step: these bytes, or the content of a file of ours.

        Raises
        ------
        SourceError
            The source is read-only, full or gone.
        """
        ...

    def make_folder(self, place: str) -> None:
        """Make a folder; an existing one is kept. Errors as for `write`."""
        ...

    def rename(self, place: str, new_place: str) -> None:
        """Rename a file or folder. Errors as for `write`."""
        ...

    def clock_offset_s(self) -> float | None:
        """Return how far the source's clock is ahead of ours, s; None when it has none or does not show it."""
        ...
