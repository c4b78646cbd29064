"""The inbox: calibrations that a workstation pushed. Each is verified and copied into the store, or refused by name.

Workstations write the inbox and are not trusted with the store: links are not followed, no more is copied than the
manifest states, and the copy is hashed where it lies.
"""

from __future__ import annotations

import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from device.bundles.calibration import CALIBRATION_MANIFEST, CalibrationBundle, read_calibration
from device.bundles.layout import INBOX, is_bundle_id
from device.bundles.publishing import publish_bundle
from device.bundles.record import CHUNK_BYTES, FileEntry, read_manifest
from device.errors import DeviceError, RecordError, StoreError
from device.io.folder import Folder


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
