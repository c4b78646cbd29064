"""The calibration bundle: the presses and the reference that it was made from, the fitted model and its report."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Final

import msgspec

from device.ball import Ball
from device.bundle_files import listed_file, recorded_frame
from device.errors import RecordError
from device.fingerprint import Fingerprint
from device.records import (
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

CALIBRATION_SCHEMA: Final = "retrograph.calibration/1"
CALIBRATION_MANIFEST: Final = "calibration.json"


class BallRecord(Record, frozen=True):
    """One ball that taught: centre, trusted contact and sphere, in pixels."""

    column: float
    row: float
    contact_radius_px: Positive
    radius_px: Positive

    @classmethod
    def of(cls, ball: Ball) -> BallRecord:
        """The same as a record."""
        return cls(column=ball.column, row=ball.row, contact_radius_px=ball.contact_radius_px, radius_px=ball.radius_px)

    @property
    def ball(self) -> Ball:
        """The same as the calibration takes it."""
        return Ball(self.column, self.row, self.contact_radius_px, self.radius_px)


class RejectedRecord(Record, frozen=True):
    """A place that looked like a ball and did not teach, in pixels, and why."""

    column: float
    row: float
    reason: str


class PressRecord(Record, frozen=True):
    """One calibration press: its raw frame, the ball's radius (mm) and what was found."""

    file: FileName
    ball_radius_mm: Positive
    balls: tuple[BallRecord, ...]
    rejected: tuple[RejectedRecord, ...] = ()


class CalibrationRecord(Record, frozen=True, tag_field="schema", tag=CALIBRATION_SCHEMA):
    """The manifest of a calibration bundle.

    created : as the device believed the time; an annotation
    shape : (H, W) of every raw frame, sensor pixels
    model_files : the fitted model, opaque to the store
    asked : camera settings as asked for, which the fingerprint's were granted for; unknown in older records
    figures : the report's numbers by name, unit suffix included (None: not measured)
    files : hash and size of every file beside the manifest; filled in by the store
    """

    identity: Identity
    created: Annotated[datetime, msgspec.Meta(tz=True)]
    board: str
    gel_id: str
    pixel_pitch_um: Positive
    shape: tuple[Size, Size]
    fingerprint: Fingerprint
    reference_file: FileName
    presses: Annotated[tuple[PressRecord, ...], msgspec.Meta(min_length=1)]
    model_files: tuple[FileName, ...]
    asked: SettingsRecord | None = None
    figures: dict[str, float | None] = msgspec.field(default_factory=dict)
    files: dict[FileName, FileEntry] = msgspec.field(default_factory=dict)

    @property
    def calibration_id(self) -> str:
        """The calibration's id, also the name of its directory."""
        return self.identity.id

    @property
    def named_files(self) -> tuple[str, ...]:
        """Every file that the record speaks of."""
        return (self.reference_file, *(press.file for press in self.presses), *self.model_files)


@dataclass(frozen=True, slots=True)
class CalibrationBundle:
    """A published calibration: its directory and its record; frames are read when they are asked for."""

    directory: Path
    record: CalibrationRecord

    @property
    def calibration_id(self) -> str:
        """The calibration's id."""
        return self.record.calibration_id

    def path(self, name: str) -> Path:
        """Path of a file of the bundle.

        Raises
        ------
        RecordError
            The manifest lists no such file.
        """
        return listed_file(self.directory, self.record.files, name)

    def reference(self) -> RawFrame:
        """The frame of the skin at rest, read from disk.

        Raises
        ------
        RecordError
            The file is missing or damaged, or not of the size that the record states.
        """
        return self._frame(self.record.reference_file)

    def press_frame(self, press: PressRecord) -> RawFrame:
        """The frame of one of the record's presses, read from disk.

        Raises
        ------
        RecordError
            As for `reference`.
        """
        return self._frame(press.file)

    def verify(self) -> None:
        """Hash every file and compare.

        Raises
        ------
        RecordError
            Names every file that is missing or differs.
        """
        verify_files(self.directory, self.record.files)

    def _frame(self, name: str) -> RawFrame:
        return recorded_frame(self.path(name), self.record.shape)


def decode_calibration(data: bytes, source: str | Path) -> CalibrationRecord:
    """The calibration record that a manifest's bytes hold; `source` names it in errors.

    Raises
    ------
    RecordError
        Unknown version, damaged, or a named file is not listed.
    """
    record = decode_record(data, CalibrationRecord, source)
    unlisted = [name for name in record.named_files if name not in record.files]
    if unlisted:
        raise RecordError(f"{source}: files: {', '.join(unlisted)} is not listed there: fetch it again")
    return record


def read_calibration(directory: Path) -> CalibrationBundle:
    """The calibration bundle in a directory; its manifest is proven, its other files are not read.

    Raises
    ------
    RecordError
        No calibration there, an unknown version, a damaged manifest, or a folder named like another.
    """
    manifest = read_manifest(directory, CALIBRATION_MANIFEST)
    record = decode_calibration(manifest, directory / CALIBRATION_MANIFEST)
    check_folder_name(directory, record.identity)
    return CalibrationBundle(directory, record)
