"""Bundles on their way into a library: while some are read back and published, the next one is fetched."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Final

from device.bundles.bundle import MANIFESTS, RECEIPTS, BundleKind, Receipt, receipt_name
from device.bundles.record import encode_record, read_manifest, sha256_bytes, verify_files
from device.errors import DeviceError
from host_sync.errors import BusyBundle, HostError, LibraryError, SourceError, SourceLost
from host_sync.library.index import files_by_hash
from host_sync.library.intake import forget_refusal
from host_sync.library.library import Library
from host_sync.offload.bundle_transfer import Advance, RemoteBundle, download, verify
from host_sync.offload.source import Source

MAX_UNDER_WAY: Final = 2
"""Bundles that are read back at a time: while one waits for its disk, another is hashed."""

MAX_REFUSALS: Final = 3


class IngestQueue:
    """A context manager; when it ends, every complete bundle is published or noted as failed."""

    def __init__(self, source: Source, library: Library, report: PullReport, receipts: ReceiptWriter | None) -> None:
        self._source = source
        self._library = library
        self._report = report
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
        with self._report.recording_failure(offer.kind, offer.bundle_id), ExitStack() as stack:
            partial = stack.enter_context(self._library.publishing(offer.kind, offer.bundle_id, offer.files))
            download(self._source, offer, partial, advance, self._known)
            while len(self._under_way) >= MAX_UNDER_WAY:
                self._collect()
            self._under_way.append((offer, self._background.submit(self._finish, stack.pop_all(), offer, partial)))

    def _collect(self) -> None:
        """Wait for the bundle that has been under way the longest and note its outcome."""
        offer, finished = self._under_way.popleft()
        with self._report.recording_failure(offer.kind, offer.bundle_id):
            lost = finished.result()
            self._report.copied.append(offer.bundle_id)
            self._report.lost = self._report.lost or lost

    def _finish(self, publishing: ExitStack, offer: RemoteBundle, partial: Path) -> str | None:
        """Publish a bundle; returns why the source could not take its receipt, None when it did.

        The next pull reads such a bundle back and leaves the receipt.
        """
        with publishing:
            verify(offer, partial)
        self._library.record("taken-in", offer.kind, offer.bundle_id, offer.manifest, self._source.name)
        with suppress(OSError):
            forget_refusal(self._library.root, offer.kind, offer.bundle_id)
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


@dataclass(frozen=True, slots=True)
class PullFailure:
    """A bundle, or an entry of the source, that was passed over, and why."""

    bundle_id: str
    reason: str


@dataclass(slots=True)
class PullReport:
    """Outcome of a pull, by ids, noted as it happens.

    refused : called with kind, name and reason of each failure
    unread : of those already there, the ones that an earlier pull verified; not hashed again
    needs : ids of calibrations by scan
    without_calibration : scans whose calibration neither the source nor the library holds
    copied_bytes : fetched from the source, without what an earlier pull had left
    unreceipted : why the source takes no receipts, None when it took some
    refused_receipts : the receipts that a source refused which took others
    lost : why the source went away before the end, None when it did not
    """

    refused: Callable[[BundleKind, str, str], None]
    copied: list[str] = field(default_factory=list)
    already_there: list[str] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)
    failed: list[PullFailure] = field(default_factory=list)
    needs: dict[str, str] = field(default_factory=dict)
    without_calibration: list[str] = field(default_factory=list)
    copied_bytes: int = 0
    unreceipted: str | None = None
    refused_receipts: list[PullFailure] = field(default_factory=list)
    lost: str | None = None

    @property
    def complete(self) -> bool:
        """True if everything that the source offers is in the library now, and it took the receipts or takes none."""
        return not self.failed and not self.refused_receipts and self.lost is None

    @property
    def here(self) -> int:
        """Return how many of the source's bundles are in the library now."""
        return len(self.copied) + len(self.already_there)

    def fail(self, kind: BundleKind, name: str, reason: str) -> None:
        """Note why a bundle, or an entry of the source, was passed over."""
        self.failed.append(PullFailure(name, reason))
        self.refused(kind, name, reason)

    @contextmanager
    def recording_failure(self, kind: BundleKind, bundle_id: str) -> Iterator[None]:
        """Notes an error that concerns one bundle alone; a lost source and a library without room go on."""
        try:
            yield
        except SourceLost:
            raise
        except (DeviceError, HostError) as error:
            if isinstance(error, LibraryError) and not isinstance(error, BusyBundle):
                raise
            self.fail(kind, bundle_id, str(error))

    def finish(self, library: Library, receipts: ReceiptWriter | None) -> None:
        """Note, at the end of a pull, which scans have no calibration and which receipts the source refused."""
        here, folder = {*self.copied, *self.already_there}, library.root / "calibrations"
        self.without_calibration = [
            scan for scan, needed in self.needs.items() if scan in here and not (folder / needed).is_dir()
        ]
        if receipts is not None:
            self.unreceipted = receipts.fault
            refusals = {} if receipts.fault else receipts.refusals
            self.refused_receipts = [PullFailure(*refusal) for refusal in refusals.items()]
