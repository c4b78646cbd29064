"""Freeing space: only scans with a receipt are removed, the oldest press first."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from device.bundles.layout import list_bundles, partial_name
from device.bundles.receipt import RECEIPTS, is_receipted, receipt_name
from device.bundles.record import read_manifest
from device.bundles.scan import SCAN_MANIFEST, ScanBundle, read_scan
from device.errors import RecordError
from device.io.atomic import remove_tree_quietly, sync_directory
from device.io.folder import Folder
from device.store.choices import MARKS


def acknowledged_scans(root: Path) -> list[ScanBundle]:
    """Scans of a store that may be removed, the oldest press first."""
    scans = sorted(list_bundles(root, "scans", read_scan).bundles, key=lambda scan: scan.record.identity.counter)
    return [scan for scan in scans if _is_receipted(root, scan)]


def evict_acknowledged(
    root: Path, enough: Callable[[], bool], remove: Callable[[Path], object] = remove_tree_quietly
) -> list[str]:
    """Ids of the scans that were removed, one by one, until there is `enough` room or no more may be removed.

    remove : removes the folder of a scan that no longer counts

    Raises
    ------
    OSError
        The disk refused; every scan that was not removed is whole.
    """
    freed = []
    for scan in acknowledged_scans(root):
        if enough():
            break
        unpublish(root, scan, remove)
        freed.append(scan.scan_id)
    return freed


def unpublish(root: Path, scan: ScanBundle, remove: Callable[[Path], object] = remove_tree_quietly) -> None:
    """Remove a scan; it disappears in one step, so that a power cut never leaves half of it."""
    vanished = scan.directory.with_name(partial_name(scan.scan_id))
    scan.directory.rename(vanished)
    sync_directory(vanished.parent)
    remove(vanished)
    with suppress(OSError), Folder(root) as folder:
        folder.remove_file(f"{RECEIPTS}/{receipt_name(scan.scan_id)}")
    with suppress(OSError):
        MARKS.path(root, scan.scan_id).unlink(missing_ok=True)


def _is_receipted(root: Path, scan: ScanBundle) -> bool:
    try:
        return is_receipted(root, "scans", scan.scan_id, read_manifest(scan.directory, SCAN_MANIFEST))
    except RecordError:
        return False
