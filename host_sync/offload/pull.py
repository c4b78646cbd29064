"""Offload: every bundle that a source has and the library lacks, copied, proven, published and receipted.

A bundle that is damaged is named and left behind; the others go on. A second pull copies nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from device.bundle_layout import MANIFESTS, BundleKind
from device.errors import RecordError
from device.receipts import RECEIPTS, bundle_of
from device.records import read_small
from host_sync.errors import BusyBundle, LibraryError, SourceError, SourceLost
from host_sync.library import Library
from host_sync.library_index import files_by_hash
from host_sync.offload.bundle_transfer import Offer, fetch, read_offer
from host_sync.offload.receipting import Vouch
from host_sync.offload.source import Source

_ORDER: Final[tuple[BundleKind, ...]] = ("calibrations", "scans")
"""Calibrations first, so that no scan stands in the library without its own."""


@dataclass(frozen=True, slots=True)
class PullProgress:
    """How far a pull is: the bundle that is being copied, and bytes done of all that will be."""

    bundle_id: str
    done_bytes: int
    total_bytes: int


@dataclass(frozen=True, slots=True)
class PullFailure:
    """A bundle that was left behind, and why."""

    bundle_id: str
    reason: str


@dataclass(frozen=True, slots=True)
class PullReport:
    """What a pull did, by ids.

    without_calibration : scans whose calibration neither the source nor the library holds
    copied_bytes : that came from the source, what an earlier pull had left not counted
    unreceipted : why the source could not be given receipts, None when it has them all
    lost : why the source went away before the end, None when it did not
    """

    copied: tuple[str, ...]
    already_there: tuple[str, ...]
    failed: tuple[PullFailure, ...]
    without_calibration: tuple[str, ...]
    copied_bytes: int
    unreceipted: str | None
    lost: str | None

    @property
    def complete(self) -> bool:
        """Whether everything that the source offers is now in the library."""
        return not self.failed and self.lost is None

    @property
    def here(self) -> int:
        """How many of the source's bundles are now in the library."""
        return len(self.copied) + len(self.already_there)


@dataclass(slots=True)
class _Ledger:
    """The report while it is being written."""

    copied: list[str] = field(default_factory=list)
    already_there: list[str] = field(default_factory=list)
    failed: list[PullFailure] = field(default_factory=list)
    needs: dict[str, str] = field(default_factory=dict)
    copied_bytes: int = 0
    lost: str | None = None

    @contextmanager
    def noting(self, offer: Offer, meter: _Meter) -> Iterator[None]:
        """Notes whether a bundle was copied; what concerns this one alone goes no further."""
        try:
            yield
            self.copied.append(offer.bundle_id)
        except SourceLost:
            raise
        except (RecordError, SourceError, BusyBundle) as error:
            self.failed.append(PullFailure(offer.bundle_id, str(error)))
        finally:
            self.copied_bytes += meter.fetched_bytes

    def report(self, library: Library, unreceipted: str | None) -> PullReport:
        here = {*self.copied, *self.already_there}
        folder: Path = library.root / "calibrations"
        orphans = (scan for scan, needed in self.needs.items() if scan in here and not (folder / needed).is_dir())
        return PullReport(
            copied=tuple(self.copied),
            already_there=tuple(self.already_there),
            failed=tuple(self.failed),
            without_calibration=tuple(orphans),
            copied_bytes=self.copied_bytes,
            unreceipted=unreceipted,
            lost=self.lost,
        )


def pull(
    source: Source,
    library: Library,
    progress: Callable[[PullProgress], None] = lambda _: None,
    vouch: Vouch | None = None,
) -> PullReport:
    """The report of copying everything that the library lacks.

    vouch : writes the receipts; without it the source gets none

    Raises
    ------
    SourceError
        The source as a whole cannot be read.
    LibraryError
        The library is full, cannot be written, or is being filled by another program.
    """
    with library.writing():
        return pull_into(library, source, progress, vouch)


def pull_into(
    library: Library, source: Source, progress: Callable[[PullProgress], None], vouch: Vouch | None
) -> PullReport:
    """The same for a library that the caller holds for writing; several sources may fill it side by side."""
    ledger = _Ledger()
    receipted = {bundle_of(name) for name in source.names(RECEIPTS)} if vouch else set()
    try:
        offers = _survey(source, library, ledger, receipted, vouch)
        total_bytes = sum(offer.size_bytes for offer in offers)
        _require_space(library, total_bytes)
        known = files_by_hash(library) if offers else {}
        done_bytes = 0
        for offer in offers:
            meter = _Meter(offer.bundle_id, done_bytes, total_bytes, progress)
            with ledger.noting(offer, meter), library.publishing(offer.kind, offer.bundle_id) as partial:
                fetch(source, offer, partial, meter.advance, known)
            if vouch and offer.bundle_id in ledger.copied:
                vouch.for_bundle(source, offer)
            done_bytes += offer.size_bytes
    except SourceLost as error:
        ledger.lost = str(error)
    return ledger.report(library, vouch.fault if vouch else None)


def _survey(
    source: Source, library: Library, ledger: _Ledger, receipted: set[str | None], vouch: Vouch | None
) -> list[Offer]:
    """The offers that the library lacks; what it has and what is damaged goes to the ledger."""
    wanted = []
    for kind in _ORDER:
        for bundle_id in source.bundle_ids(kind):
            if bundle_id in receipted and (library.root / kind / bundle_id).is_dir():
                ledger.already_there.append(bundle_id)
                continue
            try:
                offer = read_offer(source, kind, bundle_id)
                if offer.calibration_id is not None:
                    ledger.needs[bundle_id] = offer.calibration_id
                if not _holds(library, offer):
                    wanted.append(offer)
                    continue
                if vouch:
                    vouch.after_rereading(source, library, offer)
                ledger.already_there.append(bundle_id)
            except SourceLost:
                raise
            except (RecordError, SourceError) as error:
                ledger.failed.append(PullFailure(bundle_id, str(error)))
    return wanted


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


def _require_space(library: Library, needed_bytes: int) -> None:
    free = library.free_bytes()
    if needed_bytes > free:
        raise LibraryError(
            f"{library.root}: {needed_bytes / 1e6:.0f} MB are to come and {free / 1e6:.0f} MB are free: "
            "free space or name another library"
        )


@dataclass(slots=True)
class _Meter:
    """Counts the bytes of one bundle and tells the caller."""

    bundle_id: str
    done_bytes: int
    total_bytes: int
    progress: Callable[[PullProgress], None]
    fetched_bytes: int = 0

    def advance(self, size_bytes: int, *, fetched: bool) -> None:
        self.done_bytes += size_bytes
        self.fetched_bytes += size_bytes if fetched else 0
        self.progress(PullProgress(self.bundle_id, self.done_bytes, self.total_bytes))
