"""Bundles that come and go: calibrations that a workstation pushed, and scans copied to a USB stick.

Each calibration of the inbox is verified and copied into the store, or refused by name. Scans on the stick are read
back and receipted: the same folders that `retrosync pull` fetches from a card.
"""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import BinaryIO, Final

from device.bundles.bundle import (
    INBOX,
    MANIFESTS,
    RECEIPTS,
    BundleKind,
    Receipt,
    is_bundle_id,
    list_bundles,
    partial_name,
    publish_bundle,
    receipt_name,
)
from device.bundles.calibration import CALIBRATION_MANIFEST, CalibrationBundle, read_calibration
from device.bundles.record import CHUNK_BYTES, FileEntry, encode_record, read_manifest, sha256_bytes
from device.bundles.scan import ScanBundle, read_scan
from device.errors import DeviceError, RecordError, StoreError
from device.io.atomic import publish_directory, remove_tree_quietly, replace_file
from device.io.folder import Folder
from device.io.system import FILE_MODE, explain_os_error

# Scans copied to <stick>/retrograph-<device>/scans/<id>/, and their calibrations to calibrations/<id>/ beside them.
#
# A copy counts when every byte of it was read back from the stick, not from memory, and agrees with the manifest. Only
# then the scan gets a receipt, as from a workstation, so that its room may be used when it is needed.

MOUNTS: Final = Path("/proc/self/mounts")
MOUNT_ROOTS: Final = ("/media/", "/run/media/", "/mnt/")
"""Where sticks are mounted."""

NO_STICK: Final = "no USB stick is mounted: insert one, wait a moment, and try again"


@dataclass(frozen=True, slots=True)
class StickExport:
    """Outcome of an export: scans that are verified on the stick, those of them copied now, and what failed."""

    verified: int
    copied: int
    failed: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The outcome in words."""
        total = self.verified + len(self.failed)
        words = f"{self.verified} of {total} scans are verified on the stick, {self.copied} copied now"
        return f"{words}: {self.failed[0]}" if self.failed else f"{words}: unmount it before you pull it out"


def find_stick(mounts: Path = MOUNTS, roots: tuple[str, ...] = MOUNT_ROOTS) -> Path:
    """Return the mounted, writable stick.

    Raises
    ------
    StoreError
        There is none, or more than one.
    """
    try:
        lines = mounts.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise StoreError(NO_STICK) from error
    places = [line.split()[1].replace("\\040", " ") for line in lines if len(line.split()) > 1]
    found = [Path(place) for place in places if place.startswith(roots) and os.access(place, os.W_OK)]
    if len(found) > 1:
        raise StoreError(f"{len(found)} sticks are mounted ({', '.join(map(str, found))}): leave one")
    if not found:
        raise StoreError(NO_STICK)
    return found[0]


def export_to_stick(root: Path, device_id: str, stick: Path, now: datetime) -> StickExport:
    """Copy every scan and calibration that the stick does not hold yet, and verify all of them there.

    Raises
    ------
    StoreError
        The stick or the store cannot be used at all.
    """
    target = stick / f"retrograph-{device_id}"
    try:
        for kind in MANIFESTS:
            (target / kind).mkdir(parents=True, exist_ok=True)
        calibrations = list_bundles(root, "calibrations", read_calibration)
        scans = list_bundles(root, "scans", read_scan)
    except OSError as error:
        raise StoreError(f"{stick}: cannot be written {explain_os_error(error)}") from error
    failed: list[str] = []
    verified = copied = 0
    bundles: tuple[ScanBundle | CalibrationBundle, ...] = (*calibrations.bundles, *scans.bundles)
    for bundle in bundles:
        is_scan = isinstance(bundle, ScanBundle)
        try:
            is_new = _export(bundle, target, "scans" if is_scan else "calibrations")
            if is_scan:
                _write_receipt(root, bundle.bundle_id, read_manifest(bundle.directory, MANIFESTS["scans"]), stick, now)
        except (DeviceError, OSError) as error:
            failed.append(str(error) if isinstance(error, DeviceError) else _explained(bundle, error))
            continue
        verified += is_scan
        copied += is_scan and is_new
    return StickExport(verified, copied, (*failed, *(damaged.reason for damaged in scans.damaged)))


def _export(bundle: ScanBundle | CalibrationBundle, target: Path, kind: BundleKind) -> bool:
    """Bring one bundle to the stick and verify it there; returns whether it was copied now."""
    final, partial = target / kind / bundle.bundle_id, target / kind / partial_name(bundle.bundle_id)
    if final.exists():
        with suppress(RecordError):
            _verify(bundle, final, kind)
            return False
        remove_tree_quietly(final)
    remove_tree_quietly(partial)
    try:
        shutil.copytree(bundle.directory, partial, copy_function=shutil.copyfile)
        publish_directory(partial, final)
    except OSError:
        remove_tree_quietly(partial)
        raise
    try:
        _verify(bundle, final, kind)
    except RecordError:
        remove_tree_quietly(final)
        raise
    return True


def _verify(bundle: ScanBundle | CalibrationBundle, copy: Path, kind: BundleKind) -> None:
    """Read a copy back from the stick and compare every byte's hash with the store's manifest."""
    for path in copy.iterdir():
        with path.open("rb") as stream, suppress(OSError):
            os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    if read_manifest(copy, MANIFESTS[kind]) != read_manifest(bundle.directory, MANIFESTS[kind]):
        raise RecordError(f"{copy}: is another bundle than that on this instrument: use another stick")
    (read_scan if kind == "scans" else read_calibration)(copy).verify()


def _write_receipt(root: Path, scan_id: str, manifest: bytes, stick: Path, now: datetime) -> None:
    receipt = Receipt(
        kind="scans",
        bundle_id=scan_id,
        manifest_sha256=sha256_bytes(manifest),
        host=f"USB stick {stick.name}"[:200],
        verified=now,
    )
    path = root / RECEIPTS / receipt_name(scan_id)
    if not path.exists():
        replace_file(path, encode_record(receipt), FILE_MODE)


def _explained(bundle: ScanBundle | CalibrationBundle, error: OSError) -> str:
    return f"{bundle.bundle_id}: cannot be copied {explain_os_error(error)}"


@dataclass(frozen=True, slots=True)
class InboxItem:
    """One entry of the inbox: imported, or refused for a reason."""

    name: str
    refusal: str | None


def import_inbox(root: Path, room_bytes: int) -> list[InboxItem]:
    """Return the outcome for each calibration in the inbox; afterwards the inbox holds none of them.

    room_bytes : what may be stored at most

    Raises
    ------
    OSError
        The inbox cannot be read.
    """
    try:
        with Folder(root) as folder:
            names = [entry.name for entry in folder.entries(INBOX) if is_bundle_id(entry.name)]
    except FileNotFoundError:
        return []
    return [InboxItem(name, _import(root, root / INBOX / name, room_bytes)) for name in names]


def _import(root: Path, delivered: Path, room_bytes: int) -> str | None:
    """Copy one calibration into the store; the reason when it is refused."""
    try:
        if delivered.is_symlink() or not delivered.is_dir():
            raise RecordError(f"{delivered}: is no folder: push the calibration again")
        bundle = read_calibration(delivered)
        if not (root / "calibrations" / bundle.calibration_id).exists():
            copy_calibration(root, bundle, room_bytes)
    except (DeviceError, OSError) as error:
        return str(error)
    finally:
        _remove(delivered)
    return None


def _remove(delivered: Path) -> None:
    """Remove an entry, never the target of a link."""
    if delivered.is_symlink() or not delivered.is_dir():
        with suppress(OSError):
            delivered.unlink()
    else:
        shutil.rmtree(delivered, ignore_errors=True)


def _copy(stream: BinaryIO, target: Path, size_bytes: int) -> None:
    """Copy that many bytes at most into a new file."""
    with target.open("xb") as copy:
        while size_bytes > 0 and (block := stream.read(min(size_bytes, CHUNK_BYTES))):
            copy.write(block)
            size_bytes -= len(block)


def copy_calibration(root: Path, bundle: CalibrationBundle, room_bytes: int) -> None:
    """Copy a calibration from elsewhere into a store, verified on the way.

    Raises
    ------
    RecordError
        It is damaged.
    StoreError
        There is no room.
    OSError
        The disk refused; nothing is left behind.
    """
    needed = sum(entry.size for entry in bundle.record.files.values())
    if needed > room_bytes:
        raise StoreError(f"{bundle.directory}: needs {needed / 1e6:.0f} MB, more than is free: free space first")
    bundle.verify()

    def write(directory: Path) -> None:
        with Folder(bundle.directory, follow=False) as folder:
            for name, entry in bundle.record.files.items():
                with folder.opened(name) as stream:
                    _copy(stream, directory / name, entry.size)

    def manifest(files: dict[str, FileEntry]) -> bytes:
        if files != bundle.record.files:
            raise RecordError(f"{bundle.directory}: changed while it was copied: push the calibration again")
        return read_manifest(bundle.directory, CALIBRATION_MANIFEST)

    publish_bundle(root, "calibrations", bundle.calibration_id, write, manifest)
