"""The calibration bundle: presses and reference frame, the fitted model and its figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import msgspec

from device.balls.sphere import Ball
from device.bundles.bundle import Bundle, check_files, read_record
from device.bundles.fingerprint import Fingerprint, SettingsRecord
from device.bundles.record import (
    Coordinate,
    Figures,
    FileName,
    Files,
    Identity,
    Positive,
    Record,
    ShortText,
    Size,
    Text,
    Time,
    decode_record,
)
from hal.frame import RawFrame

CALIBRATION_SCHEMA: Final = "retrograph.calibration/1"
CALIBRATION_MANIFEST: Final = "calibration.json"


class BallRecord(Record, frozen=True):
    """One ball used for training: centre, trusted contact and sphere, in pixels."""

    column: Coordinate
    row: Coordinate
    contact_radius_px: Positive
    radius_px: Positive

    @classmethod
    def of(cls, ball: Ball) -> BallRecord:
        """Return the ball as a record."""
        return cls(column=ball.column, row=ball.row, contact_radius_px=ball.contact_radius_px, radius_px=ball.radius_px)

    @property
    def ball(self) -> Ball:
        """The ball as the fit uses it."""
        return Ball(self.column, self.row, self.contact_radius_px, self.radius_px)


class RejectedRecord(Record, frozen=True):
    """A candidate that was not used, its position in pixels, and why."""

    column: Coordinate
    row: Coordinate
    reason: Text


class PressRecord(Record, frozen=True):
    """One calibration press: its raw frame, the ball's radius (mm) and what was found."""

    file: FileName
    ball_radius_mm: Positive
    balls: Annotated[tuple[BallRecord, ...], msgspec.Meta(max_length=10_000)]
    rejected: Annotated[tuple[RejectedRecord, ...], msgspec.Meta(max_length=10_000)] = ()


class CalibrationRecord(Record, frozen=True, tag_field="schema", tag=CALIBRATION_SCHEMA):
    """The manifest of a calibration bundle.

    created : by the device's clock; an annotation
    shape : (H, W) of every raw frame, sensor pixels
    model_files : the fitted model, opaque to the store
    asked : requested camera settings; None in older records
    pupil_height_mm : as of the board's profile; None where it says nothing, and in older records
    figures : the report's figures by name, with unit suffix (None: not measured)
    files : hash and size of every file beside the manifest; filled in by the store
    """

    identity: Identity
    created: Time
    board: ShortText
    gel_id: ShortText
    pixel_pitch_um: Positive
    shape: tuple[Size, Size]
    fingerprint: Fingerprint
    reference_file: FileName
    presses: Annotated[tuple[PressRecord, ...], msgspec.Meta(min_length=1, max_length=1000)]
    model_files: Annotated[tuple[FileName, ...], msgspec.Meta(max_length=100)]
    asked: SettingsRecord | None = None
    pupil_height_mm: Positive | None = None
    figures: Figures = msgspec.field(default_factory=dict)
    files: Files = msgspec.field(default_factory=dict)

    @property
    def calibration_id(self) -> str:
        """The calibration's id, also the name of its directory."""
        return self.identity.id

    @property
    def raw_files(self) -> tuple[str, ...]:
        """Names of the raw frames: the reference, then the presses."""
        return (self.reference_file, *(press.file for press in self.presses))

    @property
    def named_files(self) -> tuple[str, ...]:
        """Every file that the record refers to."""
        return (*self.raw_files, *self.model_files)


@dataclass(frozen=True, slots=True)
class CalibrationBundle(Bundle[CalibrationRecord]):
    """A published calibration."""

    @property
    def calibration_id(self) -> str:
        """The calibration's id."""
        return self.bundle_id

    def reference(self) -> RawFrame:
        """Return the frame of the untouched skin, read from disk. Errors as for `read_bundle_frame`."""
        return self._frame(self.record.reference_file)

    def press_frame(self, press: PressRecord) -> RawFrame:
        """Return the frame of one of the record's presses, read from disk. Errors as for `read_bundle_frame`."""
        return self._frame(press.file)


def decode_calibration(data: bytes, source: str | Path) -> CalibrationRecord:
    """Return the calibration record in a manifest's bytes; errors are those of `decode_scan`.

    source : names the manifest in errors
    """
    record = decode_record(data, CalibrationRecord, source)
    check_files(record, source)
    return record


def read_calibration(directory: Path) -> CalibrationBundle:
    """Return the calibration bundle in a directory, only its manifest read and checked. Errors as for `read_record`."""
    return CalibrationBundle(directory, read_record(directory, CALIBRATION_MANIFEST, decode_calibration))
