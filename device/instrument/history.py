"""Scans for review with verdict, mark, note and offload state; and job, part, operator and note of the next ones."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from threading import Lock
from typing import Final

import numpy as np
from msgspec import structs

from device.bundles.check import CheckRecord, doubt_of_checks
from device.bundles.scan import Annotations, MovieRecord, ScanBundle, VerdictRecord, read_scan
from device.errors import DeviceError, RecordError
from device.instrument.events import Failed
from device.instrument.state import StateStore
from device.io.folder import Folder
from device.io.tiff import read_page
from device.quick_look.solver import HEIGHT_FILE, quick_look_binning
from device.store.checks import read_checks
from device.store.choices import MARKS, ScanMark, write_sticky
from device.store.deletion import acknowledged_scans, delete_scan, purge_deleted, restore_scan
from device.store.store import BundleStore
from device.surface import Float32Array, HeightMap


@dataclass(frozen=True, slots=True)
class ScanEntry:
    """One scan of the history.

    offloaded : a workstation has acknowledged its copy
    mark : the operator's later mark; None without one
    doubt : the failed check of the check standard that makes it doubtful; empty without one
    replaced_by : number of the scan that was taken instead of it; None without one
    movie : of the press; None where none was taken
    """

    scan_id: str
    counter: int
    wall_time: datetime
    gel_id: str
    calibration_id: str | None
    verdict: VerdictRecord
    annotations: Annotations
    offloaded: bool
    mark: ScanMark | None
    doubt: str = ""
    replaced_by: int | None = None
    movie: MovieRecord | None = None


@dataclass(frozen=True, slots=True)
class History:
    """Every scan, newest first, and a sentence for each damaged one."""

    scans: tuple[ScanEntry, ...]
    damaged: tuple[str, ...]


def read_history(store: BundleStore) -> History:
    """Return the history of a store.

    Raises
    ------
    StoreError
        The store cannot be read.
    """
    listing = store.scans()
    offloaded = {scan.scan_id for scan in acknowledged_scans(store.root)}
    newest_first = sorted(listing.bundles, key=lambda scan: scan.record.identity.counter, reverse=True)
    checks = read_checks(store.root)
    replaced = {old: scan.record.identity.counter for scan in newest_first if (old := scan.record.replaces)}
    entries = (
        _entry(store.root, scan, scan.scan_id in offloaded, checks, replaced.get(scan.scan_id)) for scan in newest_first
    )
    return History(tuple(entries), tuple(bundle.reason for bundle in listing.damaged))


def read_quick_look(store: BundleStore, scan_id: str) -> HeightMap | None:
    """Return the quick look that was published with a scan; None without one.

    Raises
    ------
    RecordError
        The scan does not exist, or its files are damaged.
    """
    bundle = read_scan(store.root / "scans" / scan_id)
    if HEIGHT_FILE not in bundle.record.files:
        return None
    path = bundle.path(HEIGHT_FILE)
    try:
        with Folder(bundle.directory, follow=False) as folder, folder.opened(HEIGHT_FILE) as stream:
            z_um: Float32Array = read_page(stream, np.float32)
    except (OSError, ValueError) as error:
        raise RecordError(f"{path}: cannot be read ({error}): offload the raw frame and reconstruct it") from error
    return HeightMap(z_um, bundle.record.pixel_pitch_um * quick_look_binning(bundle.record.shape))


def _entry(
    root: Path, scan: ScanBundle, offloaded: bool, checks: tuple[CheckRecord, ...], replaced_by: int | None
) -> ScanEntry:
    record = scan.record
    failed = doubt_of_checks(
        record.identity.counter, (check for check in checks if check.calibration_id == record.calibration_id)
    )
    return ScanEntry(
        scan_id=record.scan_id,
        counter=record.identity.counter,
        wall_time=record.wall_time,
        gel_id=record.gel_id,
        calibration_id=record.calibration_id,
        verdict=record.verdict,
        annotations=record.annotations,
        offloaded=offloaded,
        mark=MARKS.read_sound(root, record.scan_id),
        doubt=failed.sentence if failed else "",
        replaced_by=replaced_by,
        movie=record.movie,
    )


# Deleting scans, with undo until the instrument is switched off.


class DeletedScans:
    """The scans that were deleted since the start; for any thread. What an earlier start deleted is removed at once."""

    def __init__(self, states: StateStore, store: BundleStore) -> None:
        self._states = states
        self._store = store
        self._lock = Lock()
        self._ids: list[str] = []
        purge_deleted(store.root)

    def delete(self, scan_id: str) -> None:
        """Delete a scan. Errors as for `delete_scan`."""
        with self._lock:
            delete_scan(self._store.root, scan_id)
            self._ids.append(scan_id)
        self._states.count_stored(-1)

    def undo(self) -> str:
        """Bring the scan that was deleted last back; returns its id.

        Raises
        ------
        RecordError
            None was deleted since the start, or its room was needed.
        StoreError
            The disk refused; the same scan can be tried again.
        """
        with self._lock:
            if not self._ids:
                raise RecordError("no scan was deleted since the instrument was switched on")
            scan_id = self._ids[-1]
            try:
                restore_scan(self._store.root, scan_id)
            except RecordError:
                self._ids.pop()
                raise
            self._ids.pop()
        self._states.count_stored(1)
        return scan_id

    def purge(self) -> None:
        """Remove them for good, at power-off."""
        with self._lock:
            self._ids.clear()
            purge_deleted(self._store.root)


_NUMBER: Final = re.compile(r"(\d+)(?!.*\d)")


def next_part(part: str) -> str:
    """Return the next part's name: "A-09" after "A-08", "lid-2" after "lid"; the last number in it counts."""
    found = _NUMBER.search(part)
    if found is None:
        return f"{part}-2"
    number = str(int(found[1]) + 1).zfill(len(found[1]))
    return f"{part[: found.start()]}{number}{part[found.end() :]}"


class ScanLabels:
    """The annotations of the next scans, in the state and on the disk; for any thread."""

    def __init__(self, states: StateStore, store: BundleStore) -> None:
        self._states = states
        self._store = store
        self._lock = Lock()

    def set(self, annotations: Annotations) -> None:
        """Use these for every later scan, also after a restart."""
        with self._lock:
            self._set(annotations)

    def take(self) -> Annotations:
        """Return the annotations of a scan that was taken now; the next part gets the next number."""
        with self._lock:
            taken = self._states.state.sticky
            if self._states.state.settings.number_parts and taken.part:
                self._set(structs.replace(taken, part=next_part(taken.part)))
            return taken

    def give_back(self, annotations: Annotations) -> None:
        """The scan that took them was not stored: the next one gets its number, unless another has one already."""
        with self._lock:
            part = annotations.part
            if part and self._states.state.sticky == structs.replace(annotations, part=next_part(part)):
                self._set(annotations)

    def _set(self, annotations: Annotations) -> None:
        self._states.update(sticky=annotations)
        try:
            write_sticky(self._store.root, annotations)
        except DeviceError as error:
            self._states.publish(Failed(str(error)))
