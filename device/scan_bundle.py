"""The scan bundle: one press of the button, one directory, immutable once published."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from device.bundle_files import listed_file, recorded_frame
from device.errors import RecordError
from device.fingerprint import Fingerprint
from device.records import (
    BundleId,
    FileEntry,
    FileName,
    Identity,
    Positive,
    Record,
    Size,
    check_folder_name,
    decode_record,
    read_manifest,
    verify_files,
)
from device.settings_record import SettingsRecord
from hal.frame import RawFrame
from hal.interfaces import PowerReading

SCAN_SCHEMA: Final = "retrograph.scan/1"
SCAN_MANIFEST: Final = "scan.json"

VerdictLevel = Literal["good", "doubtful", "retake"]


class VerdictRecord(Record, frozen=True):
    """What the quick look says of a press: a level, one sentence, and the figures behind it (None: not measured)."""

    level: VerdictLevel
    reason: str
    figures: dict[str, float | None] = msgspec.field(default_factory=dict)


class PowerRecord(Record, frozen=True):
    """Supply and battery at the press; None is "not measured".

    under_voltage : the supply was too low then
    was_under_voltage : it had been, at some time since boot
    throttled : the processor was slowed down
    battery_mv, battery_share : cell voltage (mV) and charge (0 to 1)
    """

    under_voltage: bool | None = None
    was_under_voltage: bool | None = None
    throttled: bool | None = None
    battery_mv: float | None = None
    battery_share: float | None = None

    @classmethod
    def of(cls, reading: PowerReading) -> PowerRecord:
        """The same as a record."""
        return cls(**{name: getattr(reading, name) for name in cls.__struct_fields__})


class LightFaultRecord(Record, frozen=True):
    """What the light driver believed of one light while it shone, such as "open"; advisory."""

    light: str
    kind: str


class Annotations(Record, frozen=True):
    """What people say about a scan; no part of its identity."""

    job: str | None = None
    part: str | None = None
    operator: str | None = None
    note: str | None = None


class ScanRecord(Record, frozen=True, tag_field="schema", tag=SCAN_SCHEMA):
    """The manifest of a scan bundle.

    identity : what tells this scan from all others
    wall_time : as the device believed it; an annotation
    shape : (H, W) of the raw frame, sensor pixels
    asked, granted : camera settings as asked for, and as the frame's own metadata states them
    currents_ma : current of each light as granted, mA
    calibration_id : of the calibration that was active, or None
    power : supply and battery at the press
    light_faults : what the light driver said while the lights shone; None when it could not be asked
    files : hash and size of every file beside the manifest; filled in by the store
    """

    identity: Identity
    wall_time: Annotated[datetime, msgspec.Meta(tz=True)]
    board: str
    pixel_pitch_um: Positive
    shape: tuple[Size, Size]
    gel_id: str
    asked: SettingsRecord
    granted: SettingsRecord
    currents_ma: dict[str, Positive]
    fingerprint: Fingerprint
    calibration_id: BundleId | None
    verdict: VerdictRecord
    annotations: Annotations = Annotations()
    power: PowerRecord = PowerRecord()
    light_faults: tuple[LightFaultRecord, ...] | None = None
    raw_file: FileName = "raw.tif"
    files: dict[FileName, FileEntry] = msgspec.field(default_factory=dict)

    @property
    def scan_id(self) -> str:
        """The scan's id, also the name of its directory."""
        return self.identity.id


@dataclass(frozen=True, slots=True)
class ScanBundle:
    """A published scan: its directory and its record; the raw frame is read when it is asked for."""

    directory: Path
    record: ScanRecord

    @property
    def scan_id(self) -> str:
        """The scan's id."""
        return self.record.scan_id

    def path(self, name: str) -> Path:
        """Path of a file of the bundle.

        Raises
        ------
        RecordError
            The manifest lists no such file.
        """
        return listed_file(self.directory, self.record.files, name)

    def raw_frame(self) -> RawFrame:
        """The raw frame, read from disk.

        Raises
        ------
        RecordError
            The file is missing or damaged, or not of the size that the record states.
        """
        return recorded_frame(self.path(self.record.raw_file), self.record.shape)

    def verify(self) -> None:
        """Hash every file and compare.

        Raises
        ------
        RecordError
            Names every file that is missing or differs.
        """
        verify_files(self.directory, self.record.files)


def decode_scan(data: bytes, source: str | Path) -> ScanRecord:
    """The scan record that a manifest's bytes hold; `source` names it in errors.

    Raises
    ------
    RecordError
        Unknown version, damaged, or a named file is not listed.
    """
    record = decode_record(data, ScanRecord, source)
    if record.raw_file not in record.files:
        raise RecordError(f"{source}: raw_file: {record.raw_file!r} is not among files: fetch it again")
    return record


def read_scan(directory: Path) -> ScanBundle:
    """The scan bundle in a directory; its manifest is proven, its other files are not read.

    Raises
    ------
    RecordError
        No scan there, an unknown version, a damaged manifest, or a folder named like another.
    """
    manifest = read_manifest(directory, SCAN_MANIFEST)
    record = decode_scan(manifest, directory / SCAN_MANIFEST)
    check_folder_name(directory, record.identity)
    return ScanBundle(directory, record)
