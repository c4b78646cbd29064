"""Offload: every bundle that a source has and the library lacks is copied, verified, published and receipted.

What is damaged or hostile is named and passed over; the rest goes on. A second pull copies nothing. Several devices
are pulled side by side. The other way, a calibration is pushed into a device's inbox, and verified there on import.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from device.bundles.bundle import (
    INBOX,
    MANIFESTS,
    RECEIPTS,
    BundleKind,
    is_utf_8,
    partial_name,
    receipt_name,
    receipted_bundle,
)
from device.bundles.calibration import CALIBRATION_MANIFEST, CalibrationBundle
from device.bundles.record import checksum_name, read_small
from device.errors import DeviceError, RecordError
from host_sync.errors import HostError, LibraryError, SourceError, SourceLost
from host_sync.library.library import Library
from host_sync.offload.bundle_transfer import RemoteBundle, read_remote_bundle
from host_sync.offload.ingest import IngestQueue, PullReport, ReceiptWriter, read_back
from host_sync.offload.paired_devices import PairedDevice, PairedDevices, SyncState, this_host
from host_sync.offload.source import Source

_ORDER: Final[tuple[BundleKind, ...]] = ("calibrations", "scans")
"""Calibrations first, so that no scan is in the library without its own."""

MAX_BUNDLE_BYTES: Final = 8 << 30
"""A bundle that states more is not a full disk's fault."""

Opener = Callable[[PairedDevice], AbstractContextManager[Source]]


@dataclass(frozen=True, slots=True)
class PullProgress:
    """Progress of a pull: the bundle that is being copied, and bytes done of the total."""

    bundle_id: str
    done_bytes: int
    total_bytes: int


Progress = Callable[[PairedDevice, PullProgress], None]


def pull(
    source: Source,
    library: Library,
    progress: Callable[[PullProgress], None] = lambda _: None,
    receipts: ReceiptWriter | None = None,
    *,
    verify: bool = False,
    trust_record: bool = False,
) -> PullReport:
    """Copy everything that the library lacks; returns a report.

    receipts : writes the receipts; without it the source gets none
    verify : hash again what an earlier pull has verified
    trust_record : without receipts, too, believe the library's own record of what it has verified

    Raises
    ------
    LibraryError
        The library is full, cannot be written, or is being filled by another program.
    """
    with library.writing():
        return pull_into(library, source, progress, receipts, verify=verify, trust_record=trust_record)


def pull_into(
    library: Library,
    source: Source,
    progress: Callable[[PullProgress], None],
    receipts: ReceiptWriter | None,
    *,
    verify: bool = False,
    trust_record: bool = False,
) -> PullReport:
    """Return the same for a library that the caller holds for writing; several sources may fill it side by side."""
    report = PullReport(refused=lambda kind, name, reason: library.refuse(kind, name, reason, source.name))
    try:
        receipted = _receipted(source, report, receipts)
        survey = _Survey(source, library, report, receipted, receipts, verify=verify, trust_record=trust_record)
        offers = _fitting(survey.wanted(), library, report)
        if offers:
            _copy(offers, IngestQueue(source, library, report, receipts), report, progress)
    except SourceLost as error:
        report.lost = str(error)
    report.finish(library, receipts)
    return report


def _receipted(source: Source, report: PullReport, receipts: ReceiptWriter | None) -> set[str | None]:
    """Return ids that the source has a file of receipt for: a hint only, the library's own record decides."""
    if receipts is None:
        return set()
    try:
        return {receipted_bundle(name) for name in source.names(RECEIPTS)}
    except SourceLost:
        raise
    except SourceError as error:
        report.fail("scans", RECEIPTS, str(error))
        return set()


@dataclass(frozen=True, slots=True)
class _Survey:
    """Compares what a source offers with what the library holds.

    receipted : ids that the source has a receipt file for
    verify : hash again what an earlier pull has verified
    trust_record : skip what the library's record has, although the source has no receipt for it
    """

    source: Source
    library: Library
    report: PullReport
    receipted: Collection[str | None]
    receipts: ReceiptWriter | None
    verify: bool
    trust_record: bool

    def wanted(self) -> list[RemoteBundle]:
        """Return the offers that the library lacks; everything else goes to the report."""
        wanted = []
        for kind in _ORDER:
            for bundle_id in self._ids(kind):
                with self.report.recording_failure(kind, bundle_id):
                    if offer := self._wanted(kind, bundle_id):
                        wanted.append(offer)
        return wanted

    def _ids(self, kind: BundleKind) -> tuple[str, ...]:
        with self.report.recording_failure(kind, kind):
            found = self.source.bundle_names(kind)
            for name in found.passed_over:
                problem = "is no bundle and was skipped" if is_utf_8(name) else "its name is not UTF-8"
                self.report.fail(kind, name, f"{self.source.name}/{kind}/{name}: {problem}: check the card")
            return found.ids
        return ()

    def _wanted(self, kind: BundleKind, bundle_id: str) -> RemoteBundle | None:
        """Return the offer, or None when the library holds it; that is noted."""
        known = self.trust_record or bundle_id in self.receipted
        if known and not self.verify and self.library.looks_whole(kind, bundle_id):
            self.report.already_there.append(bundle_id)
            self.report.unread.append(bundle_id)
            return None
        offer = read_remote_bundle(self.source, kind, bundle_id)
        if offer.calibration_id is not None:
            self.report.needs[bundle_id] = offer.calibration_id
        if not _holds(self.library, offer):
            return offer
        try:
            read_back(self.library, offer)
        except RecordError as error:
            raise RecordError(f"{error}{self._withdraw_receipt(bundle_id)}") from error
        if (kind, bundle_id) not in self.library.intake().held:
            self.library.record("adopted", kind, bundle_id, offer.manifest, self.source.name)
        if self.receipts:
            self.receipts.write_for(self.source, offer)
        self.report.already_there.append(bundle_id)
        return None

    def _withdraw_receipt(self, bundle_id: str) -> str:
        """Take the receipt of a damaged copy back, so that the device keeps its own; says when that failed."""
        if bundle_id not in self.receipted:
            return ""
        place = f"{RECEIPTS}/{receipt_name(bundle_id)}"
        try:
            self.source.rename(place, f"{place}.withdrawn")
        except SourceLost:
            raise
        except SourceError as error:
            return f"; its receipt could not be withdrawn ({error}): the device may free its own copy"
        return ""


def _holds(library: Library, offer: RemoteBundle) -> bool:
    """Return whether the library has this very bundle.

    Raises
    ------
    RecordError
        It has another, or a damaged one, under the same id.
    """
    directory = library.root / offer.kind / offer.bundle_id
    if not directory.exists():
        return False
    if read_small(directory / MANIFESTS[offer.kind]) != offer.manifest:
        raise RecordError(f"{directory}: the library holds another bundle under this id: move it away and pull again")
    return True


def _fitting(offers: Sequence[RemoteBundle], library: Library, report: PullReport) -> list[RemoteBundle]:
    """Return the offers for which there is room, one after the other; the others go to the report.

    Raises
    ------
    LibraryError
        There is room for none, although some have a plausible size.
    """
    free_bytes = library.free_bytes()
    fitting, left_bytes = [], free_bytes
    for offer in offers:
        needed_bytes = max(offer.size_bytes - library.unfinished_bytes(offer.kind, offer.bundle_id), 0)
        if needed_bytes <= left_bytes:
            fitting.append(offer)
            left_bytes -= needed_bytes
        else:
            reason = f"needs {needed_bytes / 1e6:.0f} MB of the library's disk, and {left_bytes / 1e6:.0f} MB are left"
            report.fail(offer.kind, offer.bundle_id, f"{reason}: free space or name another library")
    if not fitting and any(offer.size_bytes <= MAX_BUNDLE_BYTES for offer in offers):
        needed_bytes = sum(offer.size_bytes for offer in offers)
        raise LibraryError(
            f"{library.root}: {needed_bytes / 1e6:.0f} MB must be copied and {free_bytes / 1e6:.0f} MB are free: "
            "free space or name another library"
        )
    return fitting


def _copy(
    offers: Sequence[RemoteBundle], queue: IngestQueue, report: PullReport, progress: Callable[[PullProgress], None]
) -> None:
    """Put every offer into the library, reporting progress."""
    total_bytes = sum(offer.size_bytes for offer in offers)
    before_bytes = 0
    with queue:
        for offer in offers:
            meter = _Meter(offer.bundle_id, before_bytes, total_bytes, report, progress)
            queue.add(offer, meter.advance)
            before_bytes += offer.size_bytes


@dataclass(slots=True)
class _Meter:
    """Counts the bytes of one bundle and reports them."""

    bundle_id: str
    done_bytes: int
    total_bytes: int
    report: PullReport
    progress: Callable[[PullProgress], None]

    def advance(self, size_bytes: int, *, fetched: bool) -> None:
        self.done_bytes += size_bytes
        self.report.copied_bytes += size_bytes if fetched else 0
        self.progress(PullProgress(self.bundle_id, self.done_bytes, self.total_bytes))


def utc_now() -> datetime:
    """Return the time, UTC, in whole seconds."""
    return datetime.now(UTC).replace(microsecond=0)


def sync(
    wanted: Sequence[PairedDevice],
    library: Library,
    devices: PairedDevices,
    open_device: Opener,
    report_progress: Progress,
    *,
    verify: bool = False,
) -> list[PullReport | HostError | DeviceError]:
    """Return the outcome of each device, in the given order; one that fails does not hold up the others.

    verify : hash again what an earlier pull has verified

    Raises
    ------
    LibraryError
        The library cannot be written, or is being filled by another program.
    """

    def one(device: PairedDevice) -> PullReport | HostError | DeviceError:
        try:
            return sync_one(
                device, library, devices, open_device, lambda state: report_progress(device, state), verify=verify
            )
        except (HostError, DeviceError) as error:
            return error

    with library.writing(), ThreadPoolExecutor(max_workers=max(1, len(wanted))) as threads:
        return list(threads.map(one, wanted))


def sync_one(
    device: PairedDevice,
    library: Library,
    devices: PairedDevices,
    open_device: Opener,
    report_progress: Callable[[PullProgress], None],
    *,
    verify: bool = False,
) -> PullReport:
    """Pull from one device into a library that the caller holds, and store the outcome and its clock's offset."""
    with open_device(device) as source:
        report = pull_into(library, source, report_progress, ReceiptWriter(this_host(), utc_now), verify=verify)
        offset_s = None if report.lost else source.clock_offset_s()
    devices.save_sync_state(
        SyncState(
            device_id=device.device_id,
            synced=utc_now(),
            clock_offset_s=offset_s,
            verified=report.here,
            failed=len(report.failed),
        )
    )
    return report


def push_calibration(source: Source, bundle: CalibrationBundle) -> None:
    """Verify a calibration and put it into the inbox, where it appears in one step.

    Raises
    ------
    RecordError
        The library's copy is damaged; nothing is sent.
    SourceError
        The device has it in its inbox already, or cannot be written.
    """
    bundle.verify()
    name = bundle.calibration_id
    if name in source.names(INBOX):
        raise SourceError(
            f"{source.name}: has calibration {name} in its inbox already: "
            "run `retroscan calibrations import-inbox` on it"
        )
    growing = f"{INBOX}/{partial_name(name)}"
    source.make_folder(growing)
    for file_name in (*bundle.record.files, CALIBRATION_MANIFEST, checksum_name(CALIBRATION_MANIFEST)):
        source.write(f"{growing}/{file_name}", bundle.directory / file_name)
    source.rename(growing, f"{INBOX}/{name}")
