"""The device's store: scans and calibrations that are whole or not there at all.

<root>/scans/<id>/  <root>/calibrations/<id>/  <root>/active.json  <root>/device.json
<root>/receipts/<id>.json  <root>/inbox/<id>/        the two that a workstation may write
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import msgspec

from device.active_calibration import read_active, write_active
from device.bundle_layout import MANIFESTS, BundleKind, Listing, is_bundle_id, list_bundles
from device.bundle_publishing import Write, clear_unpublished, locked_directory, publish_bundle
from device.calibration_bundle import CalibrationBundle, CalibrationRecord, decode_calibration, read_calibration
from device.device_identity import DeviceState, count_press, current_boot_id, new_device, read_device, write_device
from device.disk_advice import explain_refusal
from device.errors import DeviceError, RecordError, StoreError
from device.freeing import free_receipted
from device.inbox import INBOX, Delivery, copy_calibration, take_deliveries
from device.receipts import RECEIPTS
from device.records import FileEntry, Identity, encode_record
from device.scan_bundle import ScanBundle, ScanRecord, decode_scan, read_scan
from device.store_access import FOLDER_MODE, SHARED_MODE, free_entries, make_folder, require_writable
from hal.errors import HalError
from hal.interfaces import Clock

ENTRIES_PER_SCAN: Final = 16
"""Files and folders that a scan never needs more of."""

RESERVE_BYTES: Final = 64 << 20
"""Free space that scans never use, so that the system can always shut down and boot."""


class BundleStore:
    """Scans and calibrations under one folder; making one prepares the folder and clears what a power cut left.

    Parameters
    ----------
    root : folder of the store, made when absent
    clock : time of the identities
    boot_id : name of this boot; the kernel's when None

    Raises
    ------
    StoreError
        The folder cannot be made, read or written.
    RecordError
        `device.json` is damaged.
    """

    def __init__(self, root: Path, clock: Clock, boot_id: str | None = None) -> None:
        self.root = root
        self._clock = clock
        self._boot_id = boot_id or current_boot_id()
        with self._translating("prepared"):
            for folder in (root, *(root / kind for kind in MANIFESTS)):
                make_folder(folder, FOLDER_MODE)
            for name in (RECEIPTS, INBOX):
                make_folder(root / name, SHARED_MODE)
            with locked_directory(root):
                clear_unpublished(root)
                if read_device(root) is None:
                    write_device(root, new_device())

    @property
    def device_id(self) -> str:
        """Id of the device that this store belongs to."""
        return self._device().device_id

    def next_identity(self, kind: BundleKind) -> Identity:
        """A fresh identity; its counter is on the disk before it is handed out, and never handed out again.

        Raises
        ------
        StoreError
            The counter cannot be stored.
        """
        with self._translating("written"), locked_directory(self.root):
            state = count_press(self._device())
            write_device(self.root, state)
        suffix = "-cal" if kind == "calibrations" else ""
        return Identity(
            id=f"{state.device_id}-{self._boot_id}-{state.counter:06d}{suffix}",
            device_id=state.device_id,
            boot_id=self._boot_id,
            counter=state.counter,
            monotonic_ns=self._clock.monotonic_ns(),
        )

    def wall_time(self) -> datetime:
        """What the device believes the time is, UTC: an annotation."""
        return datetime.fromtimestamp(self._clock.wall_time_s(), UTC).replace(microsecond=0)

    def publish_scan(self, record: ScanRecord, write: Write) -> ScanBundle:
        """The published scan. `write` puts the bundle's files, flat, into the directory it is given.

        Raises
        ------
        StoreError
            The disk is full or read-only, or the id is taken; nothing is left behind.
        RecordError
            The record is not valid, or names a file that `write` did not write.
        """

        def manifest(files: dict[str, FileEntry]) -> bytes:
            data = encode_record(msgspec.structs.replace(record, files=files))
            decode_scan(data, record.scan_id)
            return data

        with self._translating("written"):
            return read_scan(publish_bundle(self.root, "scans", record.scan_id, write, manifest))

    def publish_calibration(self, record: CalibrationRecord, write: Write) -> CalibrationBundle:
        """The published calibration; it is not active yet. Arguments and errors as for `publish_scan`."""

        def manifest(files: dict[str, FileEntry]) -> bytes:
            data = encode_record(msgspec.structs.replace(record, files=files))
            decode_calibration(data, record.calibration_id)
            return data

        with self._translating("written"):
            return read_calibration(publish_bundle(self.root, "calibrations", record.calibration_id, write, manifest))

    def scans(self) -> Listing[ScanBundle]:
        """Every published scan, in order of ids, and the damaged ones by name."""
        with self._translating("read"):
            return list_bundles(self.root, "scans", read_scan)

    def calibrations(self) -> Listing[CalibrationBundle]:
        """Every published calibration, in order of ids, and the damaged ones by name."""
        with self._translating("read"):
            return list_bundles(self.root, "calibrations", read_calibration)

    def activate(self, calibration_id: str) -> CalibrationBundle:
        """The calibration that is in force from now on, proven whole first.

        Raises
        ------
        RecordError
            It is not there or damaged; the one before stays in force.
        StoreError
            The choice cannot be stored.
        """
        if not is_bundle_id(calibration_id):
            raise RecordError(f"{calibration_id!r} is no calibration id: name one of {self.root / 'calibrations'}")
        bundle = read_calibration(self.root / "calibrations" / calibration_id)
        bundle.verify()
        with self._translating("written"):
            write_active(self.root, calibration_id)
        return bundle

    def active_calibration(self) -> CalibrationBundle:
        """The calibration in force.

        Raises
        ------
        NoCalibration
            None was activated, or the active one is gone.
        RecordError
            It is damaged.
        """
        return read_active(self.root)

    def scans_left(self, bytes_per_scan: int) -> int:
        """How many more scans of that size (bytes) fit beside the reserve.

        Raises
        ------
        StoreError
            None does, as the store cannot be written: told before a press, not after it.
        """
        with self._translating("written"):
            require_writable(self.root / "scans")
        return min(self._room_bytes() // bytes_per_scan, free_entries(self.root) // ENTRIES_PER_SCAN)

    def make_room(self, size_bytes: int) -> list[str]:
        """Ids of the scans that were freed so that `size_bytes` fit beside the reserve: receipted ones, oldest first.

        Raises
        ------
        StoreError
            The disk refused.
        """
        with self._translating("written"), locked_directory(self.root):
            return free_receipted(self.root, lambda: self.scans_left(size_bytes) > 0)

    def take_inbox(self) -> list[Delivery]:
        """What became of the calibrations that a workstation pushed; those taken are listed, none is active yet.

        Raises
        ------
        StoreError
            The inbox cannot be read.
        """
        with self._translating("read"):
            return take_deliveries(self.root, self._room_bytes())

    def take_calibration(self, bundle: CalibrationBundle) -> None:
        """Copy a calibration that lies elsewhere into the store; it is not active yet.

        Raises
        ------
        RecordError
            It is damaged.
        StoreError
            There is no room, or the disk refused.
        """
        with self._translating("written"):
            copy_calibration(self.root, bundle, self._room_bytes())

    def _room_bytes(self) -> int:
        """Free space beside the reserve, bytes."""
        with self._translating("read"):
            return max(shutil.disk_usage(self.root).free - RESERVE_BYTES, 0)

    def _device(self) -> DeviceState:
        state = read_device(self.root)
        if state is None:
            raise StoreError(f"{self.root}: device.json is gone: start the program again")
        return state

    @contextmanager
    def _translating(self, verb: str) -> Iterator[None]:
        """Turns the system's errors into one sentence that says which store and what to do."""
        try:
            yield
        except (DeviceError, HalError):
            raise
        except OSError as error:
            raise StoreError(f"{self.root}: the store cannot be {verb} {explain_refusal(error)}") from error
