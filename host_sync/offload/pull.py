"""Offload: every bundle that a source has and the library lacks, copied, proven, published and receipted.

A bundle that is damaged is named and left behind; the others go on. A second pull copies nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

from device.bundle_layout import MANIFESTS, BundleKind
from device.errors import RecordError
from device.receipts import RECEIPTS, bundle_of, receipt_name
from device.records import read_small
from host_sync.errors import LibraryError, SourceError, SourceLost
from host_sync.library import Library
from host_sync.offload.assembly import Assembly
from host_sync.offload.bundle_transfer import Offer, read_offer
from host_sync.offload.ledger import Ledger, PullFailure, PullReport
from host_sync.offload.receipting import Vouch, reread
from host_sync.offload.source import Source

_ORDER: Final[tuple[BundleKind, ...]] = ("calibrations", "scans")
"""Calibrations first, so that no scan stands in the library without its own."""


@dataclass(frozen=True, slots=True)
class PullProgress:
    """How far a pull is: the bundle that is being copied, and bytes done of all that will be."""

    bundle_id: str
    done_bytes: int
    total_bytes: int


def pull(
    source: Source,
    library: Library,
    progress: Callable[[PullProgress], None] = lambda _: None,
    vouch: Vouch | None = None,
    *,
    verify: bool = False,
) -> PullReport:
    """The report of copying everything that the library lacks.

    vouch : writes the receipts; without it the source gets none
    verify : hash again what an earlier pull has left a receipt of

    Raises
    ------
    SourceError
        The source as a whole cannot be read.
    LibraryError
        The library is full, cannot be written, or is being filled by another program.
    """
    with library.writing():
        return pull_into(library, source, progress, vouch, verify=verify)


def pull_into(
    library: Library,
    source: Source,
    progress: Callable[[PullProgress], None],
    vouch: Vouch | None,
    *,
    verify: bool = False,
) -> PullReport:
    """The same for a library that the caller holds for writing; several sources may fill it side by side."""
    ledger = Ledger()
    receipted = {bundle_of(name) for name in source.names(RECEIPTS)} if vouch else set()
    try:
        survey = _Survey(source, library, ledger, receipted, vouch, verify)
        offers = _fitting(survey.wanted(), library, ledger)
        if offers:
            _copy(offers, Assembly(source, library, ledger, vouch), ledger, progress)
    except SourceLost as error:
        ledger.lost = str(error)
    return ledger.report(library, vouch.fault if vouch else None)


@dataclass(frozen=True, slots=True)
class _Survey:
    """What a source offers beside what the library holds.

    receipted : ids that the source has receipts of
    verify : hash what is here although a receipt says that this was done
    """

    source: Source
    library: Library
    ledger: Ledger
    receipted: Collection[str | None]
    vouch: Vouch | None
    verify: bool

    def wanted(self) -> list[Offer]:
        """The offers that the library lacks; what it has and what is damaged goes to the ledger."""
        wanted = []
        for kind in _ORDER:
            for bundle_id in self.source.bundle_ids(kind):
                try:
                    if offer := self._wanted(kind, bundle_id):
                        wanted.append(offer)
                except SourceLost:
                    raise
                except (RecordError, SourceError) as error:
                    self.ledger.failed.append(PullFailure(bundle_id, str(error)))
        return wanted

    def _wanted(self, kind: BundleKind, bundle_id: str) -> Offer | None:
        """The offer, unless the library holds it and that was noted."""
        if not self.verify and bundle_id in self.receipted and self.library.looks_whole(kind, bundle_id):
            self.ledger.already_there.append(bundle_id)
            self.ledger.unread.append(bundle_id)
            return None
        offer = read_offer(self.source, kind, bundle_id)
        if offer.calibration_id is not None:
            self.ledger.needs[bundle_id] = offer.calibration_id
        if not _holds(self.library, offer):
            return offer
        try:
            reread(self.library, offer)
        except RecordError as error:
            raise RecordError(f"{error}{self._withdrawn(bundle_id)}") from error
        if self.vouch:
            self.vouch.for_bundle(self.source, offer)
        self.ledger.already_there.append(bundle_id)
        return None

    def _withdrawn(self, bundle_id: str) -> str:
        """Take the receipt of a damaged copy back, so that the device keeps its own; says when that failed."""
        if bundle_id not in self.receipted:
            return ""
        place = f"{RECEIPTS}/{receipt_name(bundle_id)}"
        try:
            self.source.rename(place, f"{place}.withdrawn")
        except SourceLost:
            raise
        except SourceError as error:
            return f"; its receipt could not be taken back ({error}): the device may free its own copy"
        return ""


def _holds(library: Library, offer: Offer) -> bool:
    """Whether the library has this very bundle.

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


def _fitting(offers: Sequence[Offer], library: Library, ledger: Ledger) -> list[Offer]:
    """The offers for which there is room, one after the other; the others go to the ledger, so that one whose size is
    absurd holds up nobody.

    Raises
    ------
    LibraryError
        There is room for none.
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
            ledger.failed.append(PullFailure(offer.bundle_id, f"{reason}: free space or name another library"))
    if offers and not fitting:
        needed_bytes = sum(offer.size_bytes for offer in offers)
        raise LibraryError(
            f"{library.root}: {needed_bytes / 1e6:.0f} MB are to come and {free_bytes / 1e6:.0f} MB are free: "
            "free space or name another library"
        )
    return fitting


def _copy(
    offers: Sequence[Offer], assembly: Assembly, ledger: Ledger, progress: Callable[[PullProgress], None]
) -> None:
    """Put every offer into the library, and tell how far it is."""
    total_bytes = sum(offer.size_bytes for offer in offers)
    before_bytes = 0
    with assembly:
        for offer in offers:
            meter = _Meter(offer.bundle_id, before_bytes, total_bytes, ledger, progress)
            assembly.add(offer, meter.advance)
            before_bytes += offer.size_bytes


@dataclass(slots=True)
class _Meter:
    """Counts the bytes of one bundle and tells the caller."""

    bundle_id: str
    done_bytes: int
    total_bytes: int
    ledger: Ledger
    progress: Callable[[PullProgress], None]

    def advance(self, size_bytes: int, *, fetched: bool) -> None:
        self.done_bytes += size_bytes
        self.ledger.copied_bytes += size_bytes if fetched else 0
        self.progress(PullProgress(self.bundle_id, self.done_bytes, self.total_bytes))
