"""Repairing a library: lost and damaged bundles are fetched again from a card, a device or a second library."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from device.bundles.layout import BundleKind
from device.bundles.record import sha256_bytes
from device.errors import DeviceError, RecordError
from device.io.atomic import RESULTS
from host_sync.errors import HostError, LibraryError, SourceLost
from host_sync.library.library import Library
from host_sync.library.verification import Verification, verify_library
from host_sync.offload.bundle_transfer import RemoteBundle, download, read_remote_bundle, verify
from host_sync.offload.ingest import PullFailure
from host_sync.offload.source import Source


@dataclass(frozen=True, slots=True)
class RepairReport:
    """Outcome of a repair, by ids.

    repaired : fetched again, verified and published
    failed : lost or damaged, and not repaired, with the reason
    before : the verification that the repair started from
    """

    repaired: tuple[str, ...]
    failed: tuple[PullFailure, ...]
    before: Verification


def repair(library: Library, sources: Sequence[Source], tell: Callable[[str], None] = lambda _: None) -> RepairReport:
    """Fetch every lost or damaged bundle again; the damaged copy moves to `set-aside`, its results stay with the scan.

    A bundle is only accepted with the manifest that the library's intake record names.

    Raises
    ------
    LibraryError
        The library cannot be read or written.
    """
    with library.writing():
        before = verify_library(library, tell)
        repaired, failed = [], []
        for bundle in (*before.lost, *before.damaged):
            kind: BundleKind = "scans" if bundle.directory.parent.name == "scans" else "calibrations"
            name = bundle.directory.name
            tell(name)
            reasons = [bundle.reason]
            for source in sources:
                try:
                    _replace(library, source, kind, name, bundle.reason)
                except SourceLost:
                    raise
                except (DeviceError, HostError) as error:
                    if isinstance(error, LibraryError):
                        raise
                    reasons.append(str(error))
                else:
                    repaired.append(name)
                    break
            else:
                failed.append(PullFailure(name, "; ".join(reasons)))
    return RepairReport(tuple(repaired), tuple(failed), before)


def _replace(library: Library, source: Source, kind: BundleKind, bundle_id: str, reason: str) -> None:
    offer = read_remote_bundle(source, kind, bundle_id)
    entry = library.intake().held.get((kind, bundle_id))
    if entry is not None and entry.manifest_sha256 != sha256_bytes(offer.manifest):
        raise RecordError(f"{source.name}: has another {kind.removesuffix('s')} under the id {bundle_id}")
    directory = library.root / kind / bundle_id
    moved: Path | None = None
    with library.publishing(kind, bundle_id, offer.files) as partial:
        _fetch(source, offer, partial)
        if directory.exists() or directory.is_symlink():
            moved = library.move_aside(kind, bundle_id, reason)
    library.record("taken-in", kind, bundle_id, offer.manifest, source.name)
    if moved is not None and (moved / RESULTS).is_dir():
        with library.translating("written"):
            (moved / RESULTS).rename(directory / RESULTS)


def _fetch(source: Source, offer: RemoteBundle, partial: Path) -> None:
    def ignore(size_bytes: int, *, fetched: bool) -> None:
        """A repair shows bundles, not bytes."""

    download(source, offer, partial, ignore, {})
    verify(offer, partial)
