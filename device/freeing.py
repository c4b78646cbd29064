"""Freeing space: scans that a workstation vouches for go, oldest first; no other is ever touched."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from device.bundle_layout import list_bundles, partial_name
from device.durable import discard, sync_directory
from device.errors import RecordError
from device.receipts import RECEIPTS, is_receipted, receipt_name
from device.records import read_manifest
from device.scan_bundle import SCAN_MANIFEST, ScanBundle, read_scan
from device.scan_marks import mark_path


def receipted_scans(root: Path) -> list[ScanBundle]:
    """Scans of a store that may be freed, the oldest press first."""
    scans = sorted(list_bundles(root, "scans", read_scan).bundles, key=lambda scan: scan.record.identity.counter)
    return [scan for scan in scans if _is_receipted(root, scan)]


def free_receipted(root: Path, enough: Callable[[], bool]) -> list[str]:
    """Ids of the scans that were removed, one after the other, until there is `enough` or none may be removed.

    Raises
    ------
    OSError
        The disk refused; what was not removed is whole.
    """
    freed = []
    for scan in receipted_scans(root):
        if enough():
            break
        unpublish(root, scan)
        freed.append(scan.scan_id)
    return freed


def unpublish(root: Path, scan: ScanBundle) -> None:
    """Remove a scan: it vanishes in one step, so that a power cut never leaves half of it."""
    vanished = scan.directory.with_name(partial_name(scan.scan_id))
    scan.directory.rename(vanished)
    sync_directory(vanished.parent)
    discard(vanished)
    with suppress(OSError):
        (root / RECEIPTS / receipt_name(scan.scan_id)).unlink(missing_ok=True)
        mark_path(root, scan.scan_id).unlink(missing_ok=True)


def _is_receipted(root: Path, scan: ScanBundle) -> bool:
    try:
        return is_receipted(root, scan.scan_id, read_manifest(scan.directory, SCAN_MANIFEST))
    except RecordError:
        return False
