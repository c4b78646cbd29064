"""Offload: every bundle that a source has and the library lacks, copied, proven and published.

A bundle that is damaged is named and left behind; the others go on. A second pull copies nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from device.bundle_layout import MANIFESTS, BundleKind
from device.errors import RecordError
from device.records import read_small
from host_sync.errors import LibraryError, SourceError
from host_sync.library import Library
from host_sync.offload.bundle_transfer import Offer, fetch, read_offer
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
    """

    copied: tuple[str, ...]
    already_there: tuple[str, ...]
    failed: tuple[PullFailure, ...]
    without_calibration: tuple[str, ...]
    copied_bytes: int

    @property
    def complete(self) -> bool:
        """Whether everything that the source offers is now in the library."""
        return not self.failed


@dataclass(slots=True)
class _Ledger:
    """The report while it is being written."""

    copied: list[str] = field(default_factory=list)
    already_there: list[str] = field(default_factory=list)
    failed: list[PullFailure] = field(default_factory=list)
    needs: dict[str, str] = field(default_factory=dict)
    copied_bytes: int = 0


def pull(source: Source, library: Library, progress: Callable[[PullProgress], None] = lambda _: None) -> PullReport:
    """The report of copying everything that the library lacks.

    Raises
    ------
    SourceError
        The source as a whole cannot be read.
    LibraryError
        The library is full, cannot be written, or is being filled by another program.
    """
    ledger = _Ledger()
    with library.writing():
        offers = _survey(source, library, ledger)
        total_bytes = sum(offer.size_bytes for offer in offers)
        _require_space(library, total_bytes)
        done_bytes = 0
        for offer in offers:
            _copy(source, library, offer, ledger, _Meter(offer.bundle_id, done_bytes, total_bytes, progress))
            done_bytes += offer.size_bytes
    return PullReport(
        copied=tuple(ledger.copied),
        already_there=tuple(ledger.already_there),
        failed=tuple(ledger.failed),
        without_calibration=_orphans(library, ledger),
        copied_bytes=ledger.copied_bytes,
    )


def _survey(source: Source, library: Library, ledger: _Ledger) -> list[Offer]:
    """The offers that the library lacks; what it has and what is damaged goes to the ledger."""
    wanted = []
    for kind in _ORDER:
        for bundle_id in source.bundle_ids(kind):
            try:
                offer = read_offer(source, kind, bundle_id)
                if offer.calibration_id is not None:
                    ledger.needs[bundle_id] = offer.calibration_id
                if _holds(library, offer):
                    ledger.already_there.append(bundle_id)
                else:
                    wanted.append(offer)
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


def _copy(source: Source, library: Library, offer: Offer, ledger: _Ledger, meter: _Meter) -> None:
    try:
        with library.publishing(offer.kind, offer.bundle_id) as partial:
            fetch(source, offer, partial, meter.advance)
    except (RecordError, SourceError) as error:
        ledger.failed.append(PullFailure(offer.bundle_id, str(error)))
    else:
        ledger.copied.append(offer.bundle_id)
        ledger.copied_bytes += offer.size_bytes


def _orphans(library: Library, ledger: _Ledger) -> tuple[str, ...]:
    here = set(ledger.copied) | set(ledger.already_there)
    folder: Path = library.root / "calibrations"
    return tuple(scan for scan, needed in ledger.needs.items() if scan in here and not (folder / needed).is_dir())


@dataclass(slots=True)
class _Meter:
    """Counts the bytes of one bundle and tells the caller."""

    bundle_id: str
    done_bytes: int
    total_bytes: int
    progress: Callable[[PullProgress], None]

    def advance(self, size_bytes: int) -> None:
        self.done_bytes += size_bytes
        self.progress(PullProgress(self.bundle_id, self.done_bytes, self.total_bytes))
