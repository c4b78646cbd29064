"""Deleted scans: kept in `deleted/` until the instrument is switched off or the room is needed.

A scan leaves and comes back in one step, so that a power cut never leaves half of it. Its mark and receipt stay until
it is gone for good, and so does the record of a check, which belongs to the instrument.

Freeing space: only scans with a receipt are removed, the oldest press first.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from device.bundles.bundle import RECEIPTS, is_bundle_id, is_receipted, list_bundles, partial_name, receipt_name
from device.bundles.record import read_manifest
from device.bundles.scan import SCAN_MANIFEST, ScanBundle, read_scan
from device.errors import RecordError, StoreError
from device.io.atomic import remove_tree_quietly, sync_directory
from device.io.folder import Folder
from device.io.lock import locked_directory
from device.io.system import FOLDER_MODE, explain_os_error, make_folder
from device.store.choices import MARKS

DELETED: Final = "deleted"


def delete_scan(root: Path, scan_id: str) -> None:
    """Delete a scan; `restore_scan` brings it back.

    Raises
    ------
    RecordError
        There is no such scan.
    StoreError
        The disk refused; the scan stays.
    """
    _move(root, scan_id, "scans", DELETED, "deleted")


def restore_scan(root: Path, scan_id: str) -> None:
    """Bring a deleted scan back. Errors as for `delete_scan`."""
    _move(root, scan_id, DELETED, "scans", "brought back")


def deleted_folders(root: Path) -> list[Path]:
    """Return folders of the deleted scans, the oldest press first; before them what a power cut left of one."""
    try:
        return sorted((root / DELETED).iterdir(), key=lambda folder: (_press(folder.name), folder.name))
    except OSError:
        return []


def _press(name: str) -> int:
    """Return the counter in a scan's id; below every counter for another name."""
    counter = name.rpartition("-")[2]
    return int(counter) if is_bundle_id(name) and counter.isdecimal() else -1


def purge_deleted(root: Path) -> None:
    """Remove all deleted scans for good; one that cannot be removed is tried again the next time."""
    with suppress(OSError), locked_directory(root):
        purge_oldest(root, lambda: False)


def purge_oldest(root: Path, enough: Callable[[], bool]) -> None:
    """Remove deleted scans for good, one by one, until there is `enough` room; the caller holds the store's lock.

    A scan loses its name in one step, so that a power cut never leaves half of it to be brought back.
    """
    for folder in deleted_folders(root):
        if enough():
            return
        with suppress(OSError):
            _purge(root, folder)


def _purge(root: Path, folder: Path) -> None:
    if not is_bundle_id(folder.name):
        remove_tree_quietly(folder)
        return
    if (root / "scans" / folder.name).exists():
        return
    remove_tree_quietly(folder.with_name(partial_name(folder.name)))
    _remove(root, folder)


def _move(root: Path, scan_id: str, source: str, target: str, done: str) -> None:
    if not is_bundle_id(scan_id):
        raise RecordError(f"{scan_id!r} is no scan id: choose a scan from the history")
    try:
        make_folder(root / DELETED, FOLDER_MODE)
        with locked_directory(root):
            (root / source / scan_id).rename(root / target / scan_id)
            sync_directory(root / target)
            sync_directory(root / source)
    except FileNotFoundError as error:
        raise RecordError(f"scan {scan_id} cannot be {done}: it is no longer there") from error
    except OSError as error:
        raise StoreError(f"scan {scan_id} cannot be {done} {explain_os_error(error)}") from error


def acknowledged_scans(root: Path) -> list[ScanBundle]:
    """Return scans of a store that may be removed, the oldest press first."""
    scans = sorted(list_bundles(root, "scans", read_scan).bundles, key=lambda scan: scan.record.identity.counter)
    return [scan for scan in scans if _is_receipted(root, scan)]


def evict_acknowledged(root: Path, enough: Callable[[], bool]) -> list[str]:
    """Return ids of the scans that were removed, one by one, until there is `enough` room or no more may be removed.

    Raises
    ------
    OSError
        The disk refused; every scan that was not removed is whole.
    """
    freed = []
    for scan in acknowledged_scans(root):
        if enough():
            break
        _remove(root, scan.directory)
        freed.append(scan.scan_id)
    return freed


def _remove(root: Path, folder: Path) -> None:
    """Remove the folder of a scan in one step, so that a power cut never leaves half; then its receipt and its mark."""
    scan_id = folder.name
    vanished = folder.with_name(partial_name(scan_id))
    folder.rename(vanished)
    sync_directory(vanished.parent)
    remove_tree_quietly(vanished)
    with suppress(OSError), Folder(root) as inside:
        inside.remove_file(f"{RECEIPTS}/{receipt_name(scan_id)}")
    with suppress(OSError):
        MARKS.path(root, scan_id).unlink(missing_ok=True)


def _is_receipted(root: Path, scan: ScanBundle) -> bool:
    try:
        return is_receipted(root, "scans", scan.scan_id, read_manifest(scan.directory, SCAN_MANIFEST))
    except RecordError:
        return False
