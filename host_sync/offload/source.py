"""What scans are fetched from: a folder, a card, or a device over the network, all behind one Protocol."""

from __future__ import annotations

from typing import BinaryIO, Protocol

from device.bundle_layout import BundleKind


class Source(Protocol):
    """Somewhere that published bundles can be read."""

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

    def open_file(self, kind: BundleKind, bundle_id: str, file_name: str) -> BinaryIO:
        """One file of a bundle as a seekable stream of bytes; the caller closes it.

        Raises
        ------
        SourceError
            There is no such regular file, or it cannot be read.
        """
        ...
