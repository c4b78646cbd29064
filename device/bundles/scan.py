"""The scan bundle: one press of the button, one directory, immutable once published."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from device.bundles.bundle import Bundle, check_files, read_record
from device.bundles.check import CheckRecord
from device.bundles.fingerprint import Fingerprint, SettingsRecord
from device.bundles.raw_frame import read_bundle_frame
from device.bundles.record import (
    BundleId,
    Count,
    Figure,
    Figures,
    FileName,
    Files,
    Identity,
    NotNegative,
    Positive,
    Record,
    ShortText,
    Size,
    Text,
    Time,
    decode_record,
)
from device.errors import FrameError, RecordError
from device.imaging.frame_light import without_ambient
from hal.frame import RawFrame
from hal.interfaces import PowerReading

SCAN_SCHEMA: Final = "retrograph.scan/1"
SCAN_MANIFEST: Final = "scan.json"

VerdictLevel = Literal["good", "doubtful", "retake"]

CaptureMode = Literal["single", "average", "lights", "movie"]
"""One frame; the average of several; that, and one frame under no light and under each light alone; frames for some
seconds, of which the best is the scan."""


class VerdictRecord(Record, frozen=True):
    """The quick look's verdict: a level, one sentence, and the figures behind it (None: not measured)."""

    level: VerdictLevel
    reason: Text
    figures: Figures = msgspec.field(default_factory=dict)


class PowerRecord(Record, frozen=True):
    """Supply and battery at the press; None means not measured.

    under_voltage : the supply was too low at the press
    was_under_voltage : it was too low at some time since boot
    throttled : the processor was throttled
    battery_mv, battery_share : cell voltage (mV) and charge (0 to 1)
    """

    under_voltage: bool | None = None
    was_under_voltage: bool | None = None
    throttled: bool | None = None
    battery_mv: Figure | None = None
    battery_share: Figure | None = None

    @classmethod
    def of(cls, reading: PowerReading) -> PowerRecord:
        """Return the reading as a record."""
        return cls(**{name: getattr(reading, name) for name in cls.__struct_fields__})


class LightFaultRecord(Record, frozen=True):
    """A fault that the light driver reported for one light while it was on, such as "open"; advisory."""

    light: ShortText
    kind: ShortText


class ExposuresRecord(Record, frozen=True):
    """Exposures of the raw frame, and further frames of the same press.

    averaged : frames that were averaged
    moved : frames that were left out because the object had moved
    dark_file : the frame under no light; None if not taken
    alone_files : the frame under each light alone, by its name
    alone_moved : frames under a light alone that were left out because the object had moved
    """

    averaged: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 1
    moved: Annotated[int, msgspec.Meta(ge=0, le=10_000)] = 0
    dark_file: FileName | None = None
    alone_files: Annotated[dict[ShortText, FileName], msgspec.Meta(max_length=100)] = msgspec.field(
        default_factory=dict
    )
    alone_moved: Annotated[int, msgspec.Meta(ge=0, le=100)] = 0

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the frames beside the raw frame."""
        return (*((self.dark_file,) if self.dark_file else ()), *self.alone_files.values())


class Annotations(Record, frozen=True):
    """Notes of people about a scan; no part of its identity."""

    job: Text | None = None
    part: Text | None = None
    operator: Text | None = None
    note: Text | None = None


class ScanRecord(Record, frozen=True, tag_field="schema", tag=SCAN_SCHEMA):
    """The manifest of a scan bundle.

    wall_time : by the device's clock; an annotation
    shape : (H, W) of the raw frame, sensor pixels
    asked, granted : requested camera settings, and those in the frame's own metadata
    currents_ma : granted current of each light, mA
    calibration_id : the calibration that was active, or None
    light_faults : reported by the light driver while the lights were on; None when it cannot report
    exposures : what the raw frame is made of, and the frames under other lights
    movie : frames of the whole press, of half the size; None if not taken
    check : the last check of the check standard with this calibration; this scan itself if it has its id
    replaces : the scan of the same place that was taken again and that this one replaces; None: it is one more
    files : hash and size of every file beside the manifest; filled in by the store
    """

    identity: Identity
    wall_time: Time
    board: ShortText
    pixel_pitch_um: Positive
    shape: tuple[Size, Size]
    gel_id: ShortText
    asked: SettingsRecord
    granted: SettingsRecord
    currents_ma: Annotated[dict[ShortText, Positive], msgspec.Meta(max_length=100)]
    fingerprint: Fingerprint
    calibration_id: BundleId | None
    verdict: VerdictRecord
    annotations: Annotations = Annotations()
    power: PowerRecord = PowerRecord()
    light_faults: Annotated[tuple[LightFaultRecord, ...], msgspec.Meta(max_length=100)] | None = None
    raw_file: FileName = "raw.tif"
    exposures: ExposuresRecord = ExposuresRecord()
    movie: MovieRecord | None = None
    check: CheckRecord | None = None
    replaces: BundleId | None = None
    files: Files = msgspec.field(default_factory=dict)

    @property
    def scan_id(self) -> str:
        """The scan's id, also the name of its directory."""
        return self.identity.id

    @property
    def raw_files(self) -> tuple[str, ...]:
        """Names of the raw frames."""
        return (self.raw_file, *self.exposures.files, *(self.movie.files if self.movie else ()))

    @property
    def named_files(self) -> tuple[str, ...]:
        """Every file that the record refers to."""
        return self.raw_files


@dataclass(frozen=True, slots=True)
class ScanBundle(Bundle[ScanRecord]):
    """A published scan."""

    @property
    def scan_id(self) -> str:
        """The scan's id."""
        return self.bundle_id

    def raw_frame(self) -> RawFrame:
        """Return the raw frame, read from disk. Errors as for `read_bundle_frame`."""
        return self._frame(self.record.raw_file)

    def named_frame(self, name: str) -> RawFrame:
        """Return a raw frame by its name, such as one under a light alone. Errors as for `raw_frame`."""
        return self._frame(name)

    def movie_frame(self, name: str) -> RawFrame:
        """Return a frame of the movie by its file's name, of the size that it is stored in.

        Raises
        ------
        RecordError
            There is no movie, or the file is missing, damaged or of another size than the record states.
        """
        if self.record.movie is None:
            raise RecordError(f"{self.directory}: holds no movie")
        rows, columns = self.record.shape
        binning = self.record.movie.binning
        return read_bundle_frame(self.path(name), (rows // binning, columns // binning))

    def dark_frame(self) -> RawFrame | None:
        """Return the raw frame under no light; None if not taken. Errors as for `raw_frame`."""
        name = self.record.exposures.dark_file
        return None if name is None else self._frame(name)

    def lit_frame(self) -> RawFrame:
        """Return the raw frame without ambient light, if a frame under no light was taken.

        Raises
        ------
        RecordError
            As for `raw_frame`, or the two frames were not taken alike.
        """
        frame, dark = self.raw_frame(), self.dark_frame()
        if dark is None:
            return frame
        try:
            return without_ambient(frame, dark)
        except FrameError as error:
            raise RecordError(f"{self.directory}: {error}") from error


def decode_scan(data: bytes, source: str | Path) -> ScanRecord:
    """Return the scan record in a manifest's bytes; `source` names it in errors.

    Raises
    ------
    RecordError
        Unknown version, damaged, or a file that it refers to is not listed.
    """
    record = decode_record(data, ScanRecord, source)
    check_files(record, source)
    return record


def read_scan(directory: Path) -> ScanBundle:
    """Return the scan bundle in a directory; its manifest is checked, its other files are not read.

    Raises
    ------
    RecordError
        No scan there, an unknown version, a damaged manifest, or a folder not named by the scan's id.
    """
    return ScanBundle(directory, read_record(directory, SCAN_MANIFEST, decode_scan))


# Record of the movie of a press, in the bundle of its scan.

MAX_MOVIE_FRAMES: Final = 200


class MovieFrameRecord(Record, frozen=True):
    """One frame of a movie.

    file : the raw frame, of the scan's size divided by the binning
    at_ms : after the first one's exposure began
    contact_fraction, depth_um : fraction of the field that is in contact, and how far the skin is raised, as the guide
        measures them; None where it cannot
    """

    file: FileName
    at_ms: NotNegative
    contact_fraction: Figure | None = None
    depth_um: Figure | None = None


class MovieRecord(Record, frozen=True):
    """The movie of a press.

    binning : pixels of one colour that were taken together, in each direction
    best : number of the frame that is, averaged with later ones that did not move, the scan's own raw frame
    frames : in order of time
    """

    binning: Annotated[int, msgspec.Meta(ge=2, le=2)]
    best: Count
    frames: Annotated[tuple[MovieFrameRecord, ...], msgspec.Meta(min_length=1, max_length=MAX_MOVIE_FRAMES)]

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the frames' files."""
        return tuple(frame.file for frame in self.frames)


@dataclass(frozen=True, slots=True)
class Retake:
    """The scan that a press is to replace, as it was when the operator asked for that."""

    scan_id: str
    counter: int
    level: VerdictLevel
    annotations: Annotations

    def is_replaced_by(self, level: VerdictLevel) -> bool:
        """Return whether a press with this verdict replaces it: not one that is worse, or to be taken again itself."""
        return level != "retake" and not (level == "doubtful" and self.level == "good")
