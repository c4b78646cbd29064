"""`result.json`: the records of a result and of a video with their doubts, each written and read by the same type."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import msgspec
import numpy as np

from device.surface import Float32Array
from hal.validation import decode_json, explain_validation
from host_sync.errors import UnreadableResult
from host_sync.results.field_file import MAX_PIXELS
from host_sync.results.files import RECORD_FILE, RESULT_SCHEMA, SEQUENCE_SCHEMA, DetailName

DoubtKind = Literal[
    "failed calibration",
    "failed check standard",
    "uncovered sector",
    "extrapolated slopes",
    "drifted light",
    "frame unlike calibration",
    "no zero",
    "not converged",
    "reconstruction",
    "foreign file",
    "replaced scan",
]


REPLACED: Final[DoubtKind] = "replaced scan"
"""Its scan was taken again: it takes part in no trend and no gage study."""


class Doubt(msgspec.Struct, frozen=True):
    """One reason to distrust heights.

    kind : a few words, for outputs with little room
    reason : a clause with the facts
    sectors : names of the sectors of the field that it concerns; all of the field when empty
    """

    kind: DoubtKind
    reason: str
    sectors: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Kind and reason, as every output prints them."""
        return f"{self.kind}: {self.reason}"


def doubtful(kinds: Iterable[Doubt | str]) -> str:
    """Return the doubts in a few words, for a line that has little room; empty without doubts."""
    words = dict.fromkeys(one.kind if isinstance(one, Doubt) else one.partition(":")[0] for one in kinds)
    return f"DOUBTFUL ({', '.join(words)})" if words else ""


class SlopeNoise(msgspec.Struct, frozen=True):
    """Standard deviation of either slope's noise, as an angle of the normal, from pixel to pixel.

    In slope it is (1 + p² + q²) times as large.

    tilt_deg : tilt of the surface for which the next two are given; between them they run straight
    raw_deg, shrunk_deg : of slopes as read per pixel, from raw and from shrunk frames
    raw_kept, shrunk_kept : share of it in the slopes of the height map
    raw_height_px, shrunk_height_px : fine noise of heights over that of the height map's slopes, pixels
    blur_px, raw_blur_px : standard deviation of the blur that is taken out of the surface with shrunk and raw detail
    """

    tilt_deg: tuple[float, ...]
    raw_deg: tuple[float, ...]
    shrunk_deg: tuple[float, ...]
    raw_kept: float
    shrunk_kept: float
    raw_height_px: float
    shrunk_height_px: float
    blur_px: float = 0.0
    raw_blur_px: float = 0.0

    def added_variance(self, square: Float32Array) -> Float32Array:
        """Return the variance of either slope that raw detail has beyond shrunk detail.

        square : p² + q² in a height map; the result has its shape
        """
        more = self.variance(square, "raw") - self.variance(square, "shrunk")
        return np.asarray(np.maximum(more, np.float32(0.0)), np.float32)

    def variance(self, square: Float32Array, detail: DetailName) -> Float32Array:
        """Return the variance of either slope of a height map that is pixel noise, where p² + q² is `square`."""
        angle_deg, kept = (self.raw_deg, self.raw_kept) if detail == "raw" else (self.shrunk_deg, self.shrunk_kept)
        cosine = np.cos(np.radians(self.tilt_deg))[::-1]
        growth = np.float32(1.0) + square
        at_tilt = np.interp(1.0 / np.sqrt(growth), cosine, (kept * np.radians(angle_deg)[::-1]) ** 2)
        return np.asarray(at_tilt * growth * growth, np.float32)


Outcome = Literal["passed", "refused", "not checked"]


class FrameCheck(msgspec.Struct, frozen=True):
    """The outcome of one check of one frame.

    name : what was checked, such as "pattern position"
    outcome : "not checked" where frame or calibration hold nothing that the check could use
    value, limit : the figure that was compared and its limit, in `unit`; None where nothing was compared
    words : why it was refused or could not be made, one clause; empty when it passed
    """

    name: str
    outcome: Outcome
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    words: str = ""


def refusals(checks: Iterable[FrameCheck]) -> list[str]:
    """Return what speaks against a frame, one clause each, in the order of the checks."""
    return [check.words for check in checks if check.outcome == "refused"]


def not_checked(name: str, words: str) -> FrameCheck:
    """Return the record of a check that could not be made."""
    return FrameCheck(name, "not checked", words=words)


MAX_RECORD_BYTES: Final = 16_000_000
MIN_PITCH_UM: Final = 1e-3
MAX_PITCH_UM: Final = 1e6
MAX_RATE_HZ: Final = 1e6

Size = Annotated[int, msgspec.Meta(ge=1, le=MAX_PIXELS)]
Pitch = Annotated[float, msgspec.Meta(ge=MIN_PITCH_UM, le=MAX_PITCH_UM)]
PupilHeight = Annotated[float, msgspec.Meta(gt=0.0)]
"""mm; whatever a board's profile or a frame set may say."""

RecordT = TypeVar("RecordT", bound=msgspec.Struct)


HEIGHT_PER_PITCH: Final = 2.0
"""Share by which heights change for one share of pixel pitch."""


class HeightScale(msgspec.Struct, frozen=True):
    """Standard uncertainties of the scale; None is not measured. The samples of the height contain the measured parts.

    pixel_pitch_sigma_um : of the pixel pitch, µm
    pixel_pitch_share, ball_radius_share, height_share : relative, of pitch, ball radius and height
    not_measured : the parts that are not measured
    """

    pixel_pitch_sigma_um: float | None = None
    pixel_pitch_share: float | None = None
    ball_radius_share: float | None = None
    height_share: float | None = None
    not_measured: tuple[str, ...] = ()


class IntegrationRecord(msgspec.Struct, frozen=True):
    """Convergence of the integration.

    residuals : RMS residual of each cycle, pixels
    islands : connected components
    """

    cycles: int = 0
    residuals: tuple[float, ...] = ()
    islands: int = 0
    converged: bool = True


class DetailRecord(msgspec.Struct, frozen=True):
    """Filter and RMS height of the detail map, µm."""

    filter: str
    s_nesting_index_um: float | None
    l_nesting_index_um: float | None
    rms_um: float | None


class ResultRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Record of one result. Units are in the names; None is unknown, or not written by an earlier version."""

    schema: str = RESULT_SCHEMA
    name: str
    program: str = ""
    written_utc: str = ""
    method: str = ""
    calibration_id: str = ""
    surface_detail: DetailName = "raw"
    slope_noise: SlopeNoise | None = None
    reference: str = ""
    rows: Size
    columns: Size
    pixel_pitch_um: Pitch
    pupil_height_mm: PupilHeight | None = None
    height_min_um: float | None = None
    height_max_um: float | None = None
    height_sigma_median_um: float | None = None
    height_zero: str = ""
    height_zero_spread_um: float | None = None
    height_zero_sigma_um: float | None = None
    height_zero_skin_share: float | None = None
    masked_share: float | None = None
    clipped_share: float | None = None
    extrapolated_share: float | None = None
    warnings: tuple[str, ...] = ()
    frame_checks: tuple[FrameCheck, ...] = ()
    calibration_passed: bool | None = None
    calibration_notes: tuple[str, ...] = ()
    calibration_failed_checks: tuple[str, ...] = ()
    uncovered_sectors: tuple[str, ...] = ()
    height_scale: HeightScale = HeightScale()
    slope_sigma_median: float | None = None
    held_out_error_deg: float | None = None
    integration: IntegrationRecord | None = None
    scan_id: str | None = None
    calibration_bundle: str | None = None
    gel_id: str | None = None
    frame_set: str | None = None
    detail: DetailRecord | None = None


class SequenceFrame(msgspec.Struct, frozen=True, kw_only=True):
    """One frame of a video: either `failed` says why it has no heights, or the other optional entries are set.

    page : its page of the file of heights, from 0
    contact_share, clipped_share, masked_share : fractions of the field in contact, clipped, without a height
    peak_um : largest height above untouched skin; None where nothing was measured
    """

    page: int
    name: str = ""
    time_s: float = 0.0
    failed: str | msgspec.UnsetType = msgspec.UNSET
    contact_share: float | msgspec.UnsetType = msgspec.UNSET
    clipped_share: float | msgspec.UnsetType = msgspec.UNSET
    masked_share: float | msgspec.UnsetType = msgspec.UNSET
    peak_um: float | msgspec.UnsetType | None = msgspec.UNSET


class SequenceRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Record of a video's result. Units are in the names; None is not known, or not written by an earlier version.

    heights, height_zero : what the file of heights holds, in words
    colour_range_um : lowest and highest height of all frames, µm
    doubts : reasons to distrust the heights of all frames
    heights_per_s, pictures_per_s : frames per second from file to height on disk, and from there to the movie
    """

    schema: str = SEQUENCE_SCHEMA
    name: str
    program: str = ""
    written_utc: str = ""
    calibration_id: str = ""
    rows: Size
    columns: Size
    pixel_pitch_um: Pitch
    rate_hz: Annotated[float, msgspec.Meta(gt=0.0, lt=MAX_RATE_HZ)]
    heights: str = ""
    height_zero: str = ""
    colour_range_um: tuple[float, float] | None = None
    heights_per_s: float | None = None
    pictures_per_s: float | None = None
    method: str = ""
    encoding: str | None = None
    weighted: bool = True
    forced: bool = False
    sequence: str = ""
    calibration: str = ""
    doubts: tuple[Doubt, ...] = ()
    frames: Annotated[tuple[SequenceFrame, ...], msgspec.Meta(min_length=1)]


ListedT = TypeVar("ListedT", ResultRecord, SequenceRecord)


def encode_record(record: ResultRecord | SequenceRecord) -> bytes:
    """Return the bytes of `result.json`."""
    return msgspec.json.format(msgspec.json.encode(record), indent=2)


def read_record(folder: Path) -> ResultRecord:
    """Return the record of a result folder.

    Raises
    ------
    UnreadableResult
        It is missing, damaged, or of an unknown version.
    """
    path = folder / RECORD_FILE
    return _checked(path, _converted(path, _decoded(path), ResultRecord), RESULT_SCHEMA)


def read_listed_record(folder: Path) -> ResultRecord | SequenceRecord:
    """Return the record of a result or video for a list: an optional entry of the wrong type counts as missing.

    Raises
    ------
    UnreadableResult
        It is missing, damaged, or of an unknown version.
    """
    path = folder / RECORD_FILE
    entries = _decoded(path)
    if entries.get("schema") == SEQUENCE_SCHEMA:
        return _checked(path, _converted(path, _well_typed(entries, SequenceRecord), SequenceRecord), SEQUENCE_SCHEMA)
    return _checked(path, _converted(path, _well_typed(entries, ResultRecord), ResultRecord), RESULT_SCHEMA)


def _decoded(path: Path) -> dict[str, Any]:
    try:
        if not path.is_file():
            raise UnreadableResult(
                f"{path.parent}: holds no {path.name}: name a folder that retrosync reconstruct wrote"
            )
        if path.stat().st_size > MAX_RECORD_BYTES:
            raise UnreadableResult(f"{path}: is larger than any record: reconstruct the scan again")
        return decode_json(path.read_bytes(), dict[str, Any])
    except OSError as error:
        raise UnreadableResult(f"{path}: cannot be read ({error.strerror}): reconstruct the scan again") from error
    except msgspec.ValidationError as error:
        raise UnreadableResult(f"{path}: {explain_validation(error)}: reconstruct the scan again") from error
    except msgspec.DecodeError as error:
        raise UnreadableResult(f"{path}: {error}: reconstruct the scan again") from error


def _well_typed(entries: Mapping[str, Any], kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Return the entries without optional ones that have the wrong type."""
    kept = {}
    for field in msgspec.structs.fields(kind):
        if field.encode_name not in entries:
            continue
        value = entries[field.encode_name]
        try:
            msgspec.convert(value, field.type)
        except msgspec.ValidationError:
            if not field.required and field.encode_name != "schema":
                continue
        kept[field.encode_name] = value
    return kept


def _converted(path: Path, entries: Mapping[str, Any], kind: type[RecordT]) -> RecordT:
    try:
        return msgspec.convert(entries, kind)
    except msgspec.ValidationError as error:
        raise UnreadableResult(f"{path}: {explain_validation(error)}: reconstruct the scan again") from error


def _checked(path: Path, record: ListedT, schema: str) -> ListedT:
    if record.schema != schema:
        raise UnreadableResult(
            f"{path}: schema: {record.schema!r} is not {schema!r}: use the program that wrote it, or "
            "reconstruct the scan again"
        )
    if record.rows * record.columns > MAX_PIXELS:
        raise UnreadableResult(
            f"{path}: {record.columns} x {record.rows} is more than {MAX_PIXELS} pixels: reconstruct the scan again"
        )
    return record
