"""Log of a pull: noted as it happens, and reported at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from device.bundles.layout import BundleKind
from device.errors import DeviceError
from host_sync.errors import BusyBundle, HostError, LibraryError, SourceLost
from host_sync.library.library import Library


@dataclass(frozen=True, slots=True)
class PullFailure:
    """A bundle, or an entry of the source, that was passed over, and why."""

    bundle_id: str
    reason: str


@dataclass(frozen=True, slots=True)
class PullReport:
    """Outcome of a pull, by ids.

    unread : of those already there, the ones that an earlier pull verified; not hashed again
    without_calibration : scans whose calibration neither the source nor the library holds
    copied_bytes : fetched from the source, without what an earlier pull had left
    unreceipted : why the source takes no receipts, None when it took some
    refused_receipts : the receipts that a source refused which took others
    lost : why the source went away before the end, None when it did not
    """

    copied: tuple[str, ...]
    already_there: tuple[str, ...]
    unread: tuple[str, ...]
    failed: tuple[PullFailure, ...]
    without_calibration: tuple[str, ...]
    copied_bytes: int
    unreceipted: str | None
    refused_receipts: tuple[PullFailure, ...]
    lost: str | None

    @property
    def complete(self) -> bool:
        """True if everything that the source offers is in the library now, and it took the receipts or takes none."""
        return not self.failed and not self.refused_receipts and self.lost is None

    @property
    def here(self) -> int:
        """Return how many of the source's bundles are in the library now."""
        return len(self.copied) + len(self.already_there)


@dataclass(slots=True)
class PullLog:
    """Outcome of a pull so far.

    refused : called with kind, name and reason of each failure, as it is noted
    """

    refused: Callable[[BundleKind, str, str], None] = lambda *_: None
    copied: list[str] = field(default_factory=list)
    already_there: list[str] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)
    failed: list[PullFailure] = field(default_factory=list)
    needs: dict[str, str] = field(default_factory=dict)
    copied_bytes: int = 0
    lost: str | None = None

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

    def report(self, library: Library, unreceipted: str | None, refusals: Mapping[str, str]) -> PullReport:
        """The report; `unreceipted` is why the source takes no receipts, `refusals` why it refused some."""
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
            refused_receipts=() if unreceipted else tuple(PullFailure(*refusal) for refusal in refusals.items()),
            lost=self.lost,
        )
