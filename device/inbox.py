"""The inbox: calibrations that a workstation pushed. Each is proven and copied into the store, or refused by name.

Whoever may write into the inbox is not trusted with the store: what counts is what was copied, hashed as it lies there.
"""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from device.bundle_layout import is_bundle_id
from device.bundle_publishing import publish_bundle
from device.calibration_bundle import CALIBRATION_MANIFEST, CalibrationBundle, read_calibration
from device.errors import DeviceError, RecordError, StoreError
from device.records import CHUNK_BYTES, FileEntry, read_manifest

INBOX: Final = "inbox"


@dataclass(frozen=True, slots=True)
class Delivery:
    """One entry of the inbox by name: refused for a reason, or taken (no reason)."""

    name: str
    refusal: str | None


def take_deliveries(root: Path, room_bytes: int) -> list[Delivery]:
    """What became of each calibration in the inbox; what was taken is in the store, and the inbox is empty of it.

    room_bytes : what may be stored at most

    Raises
    ------
    OSError
        The inbox cannot be read.
    """
    inbox = root / INBOX
    if not inbox.is_dir():
        return []
    names = sorted(entry.name for entry in inbox.iterdir() if is_bundle_id(entry.name))
    return [Delivery(name, _take(root, inbox / name, room_bytes)) for name in names]


def _take(root: Path, delivered: Path, room_bytes: int) -> str | None:
    """Copy one calibration into the store; the reason when it is refused."""
    try:
        if delivered.is_symlink() or not delivered.is_dir():
            raise RecordError(f"{delivered}: is no folder: push the calibration again")
        bundle = read_calibration(delivered)
        if bundle.calibration_id != delivered.name:
            raise RecordError(f"{delivered}: holds {bundle.calibration_id}: push it under its own id")
        if not (root / "calibrations" / bundle.calibration_id).exists():
            copy_calibration(root, bundle, room_bytes)
    except (DeviceError, OSError) as error:
        return str(error)
    finally:
        _remove(delivered)
    return None


def _remove(delivered: Path) -> None:
    """Remove an entry, never what a link points at."""
    if delivered.is_symlink() or not delivered.is_dir():
        with suppress(OSError):
            delivered.unlink()
    else:
        shutil.rmtree(delivered, ignore_errors=True)


def _copy_file(source: Path, target: Path, size_bytes: int) -> None:
    """Copy a regular file that has that size; what takes its place meanwhile is not followed, nor read without end."""
    descriptor = os.open(source, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as stream, target.open("xb") as copy:
        while size_bytes > 0 and (block := stream.read(min(size_bytes, CHUNK_BYTES))):
            copy.write(block)
            size_bytes -= len(block)


def copy_calibration(root: Path, bundle: CalibrationBundle, room_bytes: int) -> None:
    """Copy a calibration that lies elsewhere into a store, proven on the way.

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
        raise StoreError(f"{bundle.directory}: needs {needed / 1e6:.0f} MB and there is less room: free space first")
    bundle.verify()

    def write(directory: Path) -> None:
        for name, entry in bundle.record.files.items():
            _copy_file(bundle.directory / name, directory / name, entry.size)

    def manifest(files: dict[str, FileEntry]) -> bytes:
        if files != bundle.record.files:
            raise RecordError(f"{bundle.directory}: changed while it was copied: push the calibration again")
        return read_manifest(bundle.directory, CALIBRATION_MANIFEST)

    publish_bundle(root, "calibrations", bundle.calibration_id, write, manifest)
