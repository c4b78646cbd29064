"""What a pull did: written down as it happens, and reported at the end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from device.errors import RecordError
from host_sync.errors import BusyBundle, SourceError, SourceLost
from host_sync.library import Library
from host_sync.offload.bundle_transfer import Offer


@dataclass(frozen=True, slots=True)
class PullFailure:
    """A bundle that was left behind, and why."""

    bundle_id: str
    reason: str


@dataclass(frozen=True, slots=True)
class PullReport:
    """What a pull did, by ids.

    unread : of those already there, what a receipt of an earlier pull and its sizes stand for; not hashed again
    without_calibration : scans whose calibration neither the source nor the library holds
    copied_bytes : that came from the source, what an earlier pull had left not counted
    unreceipted : why the source could not be given receipts, None when it has them all
    lost : why the source went away before the end, None when it did not
    """

    copied: tuple[str, ...]
    already_there: tuple[str, ...]
    unread: tuple[str, ...]
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
class Ledger:
    """What a pull did so far."""

    copied: list[str] = field(default_factory=list)
    already_there: list[str] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)
    failed: list[PullFailure] = field(default_factory=list)
    needs: dict[str, str] = field(default_factory=dict)
    copied_bytes: int = 0
    lost: str | None = None

    @contextmanager
    def noting_failure(self, offer: Offer) -> Iterator[None]:
        """Notes why a bundle was not copied, when that concerns this one alone; everything else goes on its way."""
        try:
            yield
        except SourceLost:
            raise
        except (RecordError, SourceError, BusyBundle) as error:
            self.failed.append(PullFailure(offer.bundle_id, str(error)))

    def report(self, library: Library, unreceipted: str | None) -> PullReport:
        """What stands written; `unreceipted` is why the source got no receipts, None when it did."""
        here = {*self.copied, *self.already_there}
        folder: Path = library.root / "calibrations"
        orphans = (scan for scan, needed in self.needs.items() if scan in here and not (folder / needed).is_dir())
        return PullReport(
            copied=tuple(self.copied),
            already_there=tuple(self.already_there),
            unread=tuple(self.unread),
            failed=tuple(self.failed),
            without_calibration=tuple(orphans),
            copied_bytes=self.copied_bytes,
            unreceipted=unreceipted,
            lost=self.lost,
        )
