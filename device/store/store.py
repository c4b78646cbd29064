"""The device's store: scans and calibrations that are complete or absent.

<root>/scans/<id>/  <root>/calibrations/<id>/  <root>/active.json  <root>/device.json
<root>/receipts/<id>.json  <root>/inbox/<id>/        writable for workstations
"""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import msgspec
import platformdirs

from device.bundles.bundle import (
    INBOX,
    MANIFESTS,
    RECEIPTS,
    BundleKind,
    FileWriter,
    Listing,
    bundle_ids,
    clear_unpublished,
    is_bundle_id,
    list_bundles,
    publish_bundle,
    receipted_bundle,
)
from device.bundles.calibration import CalibrationBundle, CalibrationRecord, decode_calibration, read_calibration
from device.bundles.record import FileEntry, Identity, encode_record
from device.bundles.scan import ScanBundle, ScanRecord, decode_scan, read_scan
from device.errors import DeviceError, RecordError, StoreError
from device.io.lock import locked_directory
from device.io.system import (
    FOLDER_MODE,
    SHARED_MODE,
    StatVfs,
    explain_os_error,
    free_bytes,
    free_entries,
    make_folder,
    require_writable,
)
from device.store.deletion import acknowledged_scans, deleted_folders, evict_acknowledged, purge_oldest
from device.store.device_id import DEVICE, DeviceState, count_bundle, current_boot_id, start_device
from device.store.registry_file import ACTIVE, ActiveCalibration, read_active
from device.store.transfers import InboxItem, copy_calibration, import_inbox
from hal.errors import HalError
from hal.interfaces import Clock

ENTRIES_PER_SCAN: Final = 16
"""Upper bound on the files and folders of one scan."""

RESERVE_BYTES: Final = 64 << 20
"""Free space kept from scans, so that the system can always shut down and boot."""


class BundleStore:
    """Scans and calibrations under one folder; construction prepares the folder and removes what a power cut left.

    Parameters
    ----------
    root : folder of the store, made when absent
    clock : for identities and dates
    boot_id : of this boot; the kernel's when None
    statvfs : state of the disk and the space on it

    Raises
    ------
    StoreError
        The folder cannot be made, read or written.
    RecordError
        `device.json` is damaged.
    """

    def __init__(self, root: Path, clock: Clock, boot_id: str | None = None, statvfs: StatVfs = os.statvfs) -> None:
        self.root = root
        self._statvfs = statvfs
        self._clock = clock
        self._boot_id = boot_id or current_boot_id()
        with self._translating("prepared"):
            for folder in (root, *(root / kind for kind in MANIFESTS)):
                make_folder(folder, FOLDER_MODE)
            for name in (RECEIPTS, INBOX):
                make_folder(root / name, SHARED_MODE)
            with locked_directory(root):
                clear_unpublished(root)
                if DEVICE.read(root) is None:
                    start_device(root)

    @property
    def device_id(self) -> str:
        """Id of the device that this store belongs to."""
        return self._device().device_id

    def next_identity(self, kind: BundleKind) -> Identity:
        """Return a new identity; its counter is stored durably first and never used again.

        Raises
        ------
        StoreError
            The counter cannot be stored.
        """
        with self._translating("written"), locked_directory(self.root):
            state = self._device()
            count = count_bundle(self.root, kind, state)
        suffix = "-cal" if kind == "calibrations" else ""
        return Identity(
            id=f"{state.device_id}-{self._boot_id}-{count:06d}{suffix}",
            device_id=state.device_id,
            boot_id=self._boot_id,
            counter=count,
            monotonic_ns=self._clock.monotonic_ns(),
        )

    def wall_time(self) -> datetime:
        """Return the time by the device's clock, UTC, whole seconds: an annotation."""
        return datetime.fromtimestamp(self._clock.wall_time_s(), UTC).replace(microsecond=0)

    def publish_scan(self, record: ScanRecord, write: FileWriter) -> ScanBundle:
        """Publish a scan and return it.

        write : puts the bundle's files into the directory it is given, without subfolders

        Raises
        ------
        StoreError
            The disk is full or read-only, or the id is taken; nothing is left behind.
        RecordError
            The record is not valid, or names a file that `write` did not write.
        """

        published: list[ScanRecord] = []

        def manifest(files: dict[str, FileEntry]) -> bytes:
            data = encode_record(msgspec.structs.replace(record, files=files))
            published.append(decode_scan(data, record.scan_id))
            return data

        with self._translating("written"):
            return ScanBundle(publish_bundle(self.root, "scans", record.scan_id, write, manifest), published[0])

    def publish_calibration(self, record: CalibrationRecord, write: FileWriter) -> CalibrationBundle:
        """Return the published calibration, not active yet. Arguments and errors as for `publish_scan`."""

        published: list[CalibrationRecord] = []

        def manifest(files: dict[str, FileEntry]) -> bytes:
            data = encode_record(msgspec.structs.replace(record, files=files))
            published.append(decode_calibration(data, record.calibration_id))
            return data

        with self._translating("written"):
            directory = publish_bundle(self.root, "calibrations", record.calibration_id, write, manifest)
            return CalibrationBundle(directory, published[0])

    def scans(self) -> Listing[ScanBundle]:
        """Return every published scan, sorted by id, and the damaged ones."""
        with self._translating("read"):
            return list_bundles(self.root, "scans", read_scan)

    def calibrations(self) -> Listing[CalibrationBundle]:
        """Return every published calibration, sorted by id, and the damaged ones."""
        with self._translating("read"):
            return list_bundles(self.root, "calibrations", read_calibration)

    def activate(self, calibration_id: str) -> CalibrationBundle:
        """Make a calibration the active one, after verifying all its files; returns it.

        Raises
        ------
        RecordError
            It is absent or damaged; the one before stays active.
        StoreError
            The choice cannot be stored.
        """
        if not is_bundle_id(calibration_id):
            raise RecordError(f"{calibration_id!r} is no calibration id: give one of {self.root / 'calibrations'}")
        bundle = read_calibration(self.root / "calibrations" / calibration_id)
        bundle.verify()
        ACTIVE.write(self.root, ActiveCalibration(calibration_id=calibration_id))
        return bundle

    def active_calibration(self) -> CalibrationBundle:
        """Return the active calibration.

        Raises
        ------
        NoCalibration
            None was activated, or the active one is gone.
        RecordError
            It is damaged.
        """
        return read_active(self.root)

    def scans_left(self, bytes_per_scan: int) -> int:
        """Return how many more scans of that size (bytes) fit, the reserve excluded.

        Raises
        ------
        StoreError
            The store cannot be written; so this is known before a press, not after it.
        """
        with self._translating("written"):
            require_writable(self.root / "scans", self._statvfs)
        return min(self._room_bytes() // bytes_per_scan, free_entries(self.root, self._statvfs) // ENTRIES_PER_SCAN)

    def scans_left_after_removal(self, bytes_per_scan: int) -> int:
        """Return how many more scans of this size fit once `make_room` has removed all it may.

        Nothing is removed here.

        Raises
        ------
        StoreError
            The store cannot be read.
        """
        with self._translating("read"):
            folders = [*(scan.directory for scan in acknowledged_scans(self.root)), *deleted_folders(self.root)]
            sizes = [path.lstat().st_size for folder in folders for path in (folder, *folder.rglob("*"))]
            size_bytes = free_bytes(self.root, self._statvfs) - RESERVE_BYTES + sum(sizes)
            entries = free_entries(self.root, self._statvfs) + len(sizes)
        return max(min(size_bytes // bytes_per_scan, entries // ENTRIES_PER_SCAN), 0)

    def make_room(self, size_bytes: int) -> list[str]:
        """Remove scans with a receipt, oldest first, until `size_bytes` fit; returns their ids.

        What workstations left beyond their allowance goes first. Deleted scans go last, oldest first and no more than
        needed: they may have no copy elsewhere. None of them goes where all together would not be enough.

        Raises
        ------
        StoreError
            The disk refused.
        """

        def enough() -> bool:
            return self.scans_left(size_bytes) > 0

        with self._translating("written"), locked_directory(self.root):
            tidy_shared_folders(self.root, {name for kind in MANIFESTS for name in bundle_ids(self.root, kind)})
            freed = evict_acknowledged(self.root, enough)
            if self.scans_left_after_removal(size_bytes) > 0:
                purge_oldest(self.root, enough)
        return freed

    def import_inbox(self) -> list[InboxItem]:
        """Import the calibrations that workstations pushed; returns each outcome. None becomes active.

        Raises
        ------
        StoreError
            The inbox cannot be read.
        """
        with self._translating("read"):
            return import_inbox(self.root, self._room_bytes())

    def take_calibration(self, bundle: CalibrationBundle) -> None:
        """Copy a calibration from elsewhere into the store; it does not become active.

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
        """Free space without the reserve, bytes."""
        with self._translating("read"):
            return max(free_bytes(self.root, self._statvfs) - RESERVE_BYTES, 0)

    def _device(self) -> DeviceState:
        state = DEVICE.read(self.root)
        if state is None:
            raise StoreError(f"{self.root}: device.json is missing: start the program again")
        return state

    @contextmanager
    def _translating(self, verb: str) -> Iterator[None]:
        """Turn the system's errors into one sentence that names the store and what to do."""
        try:
            yield
        except (DeviceError, HalError):
            raise
        except OSError as error:
            raise StoreError(f"{self.root}: the store cannot be {verb} {explain_os_error(error)}") from error


SERVICE_STORE: Final = Path("/var/lib/retroscan")


def default_store(service_store: Path = SERVICE_STORE) -> Path:
    """Return the service's folder when it exists and is writable, else `retroscan` in the user's data folder."""
    if service_store.is_dir() and os.access(service_store, os.W_OK):
        return service_store
    try:
        return platformdirs.user_data_path("retroscan", appauthor=False)
    except RuntimeError as error:
        raise StoreError("this user has no home folder for scans: set XDG_DATA_HOME, or name a store") from error


# Allowance of workstations on the device: receipts of stored bundles, and an inbox of limited size.
#
# Both folders are writable with any workstation's key. They are tidied when the store needs room, so that what
# they hold does not cost a scan its place.

MAX_RECEIPT_BYTES: Final = 1 << 16
MAX_INBOX_BYTES: Final = 256 << 20
MAX_INBOX_ENTRIES: Final = 32

_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def tidy_shared_folders(root: Path, bundle_ids: Collection[str]) -> None:
    """Remove receipts of no stored bundle, what is no receipt, and the largest of what is beyond the inbox's limits.

    bundle_ids : of every stored scan and calibration
    """
    with suppress(OSError), _Shared(root / RECEIPTS) as receipts:
        for name in receipts.names():
            if receipted_bundle(name) not in bundle_ids or not 0 <= receipts.file_size(name) <= MAX_RECEIPT_BYTES:
                receipts.remove(name)
    with suppress(OSError), _Shared(root / INBOX) as inbox:
        by_size = sorted((inbox.total_size(name), name) for name in inbox.names())
        total = 0
        for number, (size, name) in enumerate(by_size):
            total += size
            if number >= MAX_INBOX_ENTRIES or total > MAX_INBOX_BYTES:
                inbox.remove(name)


class _Shared:
    """An open folder whose entries, however many, are measured and removed without following a link."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, _FOLDER)

    def __enter__(self) -> _Shared:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)

    def names(self) -> list[str]:
        with os.scandir(self._descriptor) as entries:
            return [entry.name for entry in entries]

    def file_size(self, name: str) -> int:
        """Return the size of a regular file, bytes; -1 for anything else."""
        with suppress(OSError):
            facts = os.stat(name, dir_fd=self._descriptor, follow_symlinks=False)
            if stat.S_ISREG(facts.st_mode):
                return facts.st_size
        return -1

    def total_size(self, name: str) -> int:
        """Return what an entry takes, bytes: all the files of a folder. Space counts where it is more than the size."""
        total = 0
        with suppress(OSError):
            facts = os.stat(name, dir_fd=self._descriptor, follow_symlinks=False)
            total = max(facts.st_size, facts.st_blocks * 512)
            if stat.S_ISDIR(facts.st_mode):
                for _, folders, files, folder in os.fwalk(name, dir_fd=self._descriptor, follow_symlinks=False):
                    for inner in (*folders, *files):
                        with suppress(OSError):
                            facts = os.stat(inner, dir_fd=folder, follow_symlinks=False)
                            total += max(facts.st_size, facts.st_blocks * 512)
        return total

    def remove(self, name: str) -> None:
        """Remove a file, link or folder as far as the system lets us."""
        try:
            os.unlink(name, dir_fd=self._descriptor)
        except (IsADirectoryError, PermissionError):
            shutil.rmtree(name, ignore_errors=True, dir_fd=self._descriptor)
        except OSError:
            pass
