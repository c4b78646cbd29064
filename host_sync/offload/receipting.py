"""Receipts for a source: given only for what the library has stored, read back and found as promised."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import datetime

from device.bundle_layout import MANIFESTS
from device.receipts import RECEIPTS, Receipt, receipt_name
from device.records import encode_record, read_manifest, sha256_bytes, verify_files
from host_sync.errors import SourceError, SourceLost
from host_sync.library import Library
from host_sync.offload.bundle_transfer import Offer
from host_sync.offload.source import Source


def reread(library: Library, offer: Offer) -> None:
    """Return when the library's copy of a bundle, hashed once more, is what its manifest promises.

    Raises
    ------
    RecordError
        It is damaged; names the file.
    """
    directory = library.root / offer.kind / offer.bundle_id
    with library.translating("read"):
        read_manifest(directory, MANIFESTS[offer.kind])
        verify_files(directory, offer.files)


class Vouch:
    """Writes receipts to one source in this workstation's name.

    The first refusal is remembered in `fault`, and none is tried again.

    Parameters
    ----------
    host : this workstation's name, for people
    now : the time, UTC
    """

    def __init__(self, host: str, now: Callable[[], datetime]) -> None:
        self.fault: str | None = None
        self._host = host
        self._now = now
        self._has_folder = False
        self._preparing = threading.Lock()

    def for_bundle(self, source: Source, offer: Offer) -> None:
        """Receipt a bundle that was just read back; a source that takes none costs nothing else."""
        if self.fault is not None:
            return
        receipt = Receipt(
            kind=offer.kind,
            bundle_id=offer.bundle_id,
            manifest_sha256=sha256_bytes(offer.manifest),
            host=self._host,
            verified=self._now(),
        )
        try:
            with self._preparing:
                if not self._has_folder:
                    source.make_folder(RECEIPTS)
                    self._has_folder = True
            source.write(f"{RECEIPTS}/{receipt_name(offer.bundle_id)}", encode_record(receipt))
        except SourceLost:
            raise
        except SourceError as error:
            self.fault = str(error)
