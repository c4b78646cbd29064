"""Bundles on their way into a library: while some are read back and published, the next one is fetched."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, nullcontext, suppress
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Final

from device.bundles.layout import MANIFESTS
from device.bundles.receipt import RECEIPTS, Receipt, receipt_name
from device.bundles.record import encode_record, read_manifest, sha256_bytes, verify_files
from host_sync.errors import LibraryError, SourceError, SourceLost
from host_sync.library.index import files_by_hash
from host_sync.library.library import Library
from host_sync.library.set_aside import accept
from host_sync.offload.bundle_transfer import Advance, RemoteBundle, download, verify
from host_sync.offload.pull_log import PullLog
from host_sync.offload.source import Source

MAX_UNDER_WAY: Final = 2
"""Bundles that are read back at a time: while one waits for its disk, another is hashed."""

MAX_REFUSALS: Final = 3


class IngestQueue:
    """A context manager; when it ends, every complete bundle is published or noted as failed."""

    def __init__(self, source: Source, library: Library, log: PullLog, receipts: ReceiptWriter | None) -> None:
        self._source = source
        self._library = library
        self._log = log
        self._receipts = receipts
        self._known = files_by_hash(library)
        self._background = ThreadPoolExecutor(MAX_UNDER_WAY, thread_name_prefix="verify")
        self._under_way: deque[tuple[RemoteBundle, Future[str | None]]] = deque()

    def __enter__(self) -> IngestQueue:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._background:
            while self._under_way:
                # Finish what is under way in any case; its own error matters only when there is no other.
                with suppress(LibraryError) if error else nullcontext():
                    self._collect()

    def add(self, offer: RemoteBundle, advance: Advance) -> None:
        """Download a bundle; it is verified, published and receipted while the next ones are added.

        Raises
        ------
        SourceLost
            The source went away; what arrived of this bundle is kept.
        LibraryError
            The library cannot be written.
        """
        with self._log.recording_failure(offer.kind, offer.bundle_id), ExitStack() as stack:
            partial = stack.enter_context(self._library.publishing(offer.kind, offer.bundle_id, offer.files))
            download(self._source, offer, partial, advance, self._known)
            while len(self._under_way) >= MAX_UNDER_WAY:
                self._collect()
            self._under_way.append((offer, self._background.submit(self._finish, stack.pop_all(), offer, partial)))

    def _collect(self) -> None:
        """Wait for the bundle that has been under way the longest and note its outcome."""
        offer, finished = self._under_way.popleft()
        with self._log.recording_failure(offer.kind, offer.bundle_id):
            lost = finished.result()
            self._log.copied.append(offer.bundle_id)
            self._log.lost = self._log.lost or lost

    def _finish(self, publishing: ExitStack, offer: RemoteBundle, partial: Path) -> str | None:
        """Publish a bundle; returns why the source could not take its receipt, None when it did.

        The next pull reads such a bundle back and leaves the receipt.
        """
        with publishing:
            verify(offer, partial)
        self._library.record("taken-in", offer.kind, offer.bundle_id, offer.manifest, self._source.name)
        with suppress(OSError):
            accept(self._library.root, offer.kind, offer.bundle_id)
        try:
            if self._receipts:
                self._receipts.write_for(self._source, offer)
        except SourceLost as error:
            return str(error)
        return None


def read_back(library: Library, offer: RemoteBundle) -> None:
    """Return when the library's copy of a bundle, hashed again, is what its manifest states.

    Raises
    ------
    RecordError
        It is damaged; names the file.
    """
    directory = library.root / offer.kind / offer.bundle_id
    with library.translating("read"):
        read_manifest(directory, MANIFESTS[offer.kind])
        verify_files(directory, offer.files)


class ReceiptWriter:
    """Writes receipts to one source in this workstation's name.

    A source that takes none at all is not tried again after `MAX_REFUSALS`; single refusals are kept by id.

    Parameters
    ----------
    host : this workstation's name, for people
    now : the time, UTC
    """

    def __init__(self, host: str, now: Callable[[], datetime]) -> None:
        self.refusals: dict[str, str] = {}
        self.written = 0
        self._host = host
        self._now = now
        self._has_folder = False
        self._preparing = threading.Lock()

    def write_for(self, source: Source, offer: RemoteBundle) -> None:
        """Leave a receipt for a bundle that was just read back; a refusal costs nothing else."""
        if len(self.refusals) >= MAX_REFUSALS and not self.written:
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
            self.written += 1
        except SourceLost:
            raise
        except SourceError as error:
            self.refusals[offer.bundle_id] = str(error)

    @property
    def fault(self) -> str | None:
        """Why the source takes no receipts at all, None when it took one or none was due."""
        return None if self.written else next(iter(self.refusals.values()), None)
