"""One thing that can be looked at: a result, a video's result, a quick look, or the difference of two."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
import tifffile

from device.quick_look_files import HEIGHT_FILE as QUICK_LOOK_FILE
from host_sync.errors import ViewError
from host_sync.library_index import Hit

Kind = Literal["result", "video", "quick look", "difference"]

RESULT_HEIGHT: Final = "height_um.tif"
VIDEO_HEIGHTS: Final = "heights_um.tif"
RECORD_FILE: Final = "result.json"
MOST_PIXELS: Final = 200_000_000
MOST_PITCH_UM: Final = 1e6
LONGEST_TITLE: Final = 200
_RECORD_BYTES: Final = 16_000_000
"""A record that is larger was not written by this program."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What can be opened.

    key : by which the page asks for it; says nothing about where it lies
    heights : the file of height maps
    shape : (H, W)
    pages : how many height maps the file holds
    scan : directory of the scan bundle that it belongs to, if any
    hit : what the library's index says of that scan
    record : what `result.json` says
    """

    key: str
    kind: Kind
    title: str
    heights: Path
    shape: tuple[int, int]
    pitch_um: float
    pages: int = 1
    rate_hz: float | None = None
    scan: Path | None = None
    hit: Hit | None = None
    record: dict[str, Any] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """The folder of the files beside the heights."""
        return self.heights.parent

    def stamp(self) -> str:
        """Changes when the heights on disk do.

        Raises
        ------
        ViewError
            They are gone.
        """
        try:
            facts = self.heights.stat()
        except OSError as error:
            raise ViewError(f"{self.title}: its heights are gone from the disk: open the library again") from error
        words = f"{self.heights.resolve()}:{facts.st_size}:{facts.st_mtime_ns}:{self.pitch_um}"
        return hashlib.sha256(words.encode(errors="surrogateescape")).hexdigest()[:32]


def key_of(path: Path) -> str:
    """The key of what lies at a path."""
    return hashlib.sha256(str(path.resolve()).encode(errors="surrogateescape")).hexdigest()[:16]


def result_entry(folder: Path, scan: Path | None = None, hit: Hit | None = None) -> Entry:
    """The entry of a folder of results.

    Raises
    ------
    ViewError
        It holds no record or heights of this program, or they are damaged.
    """
    record = _record(folder / RECORD_FILE)
    is_video = str(record.get("schema", "")).startswith("retrograph.sequence/")
    if not is_video and not str(record.get("schema", "")).startswith("retrograph.result/"):
        raise ViewError(f"{folder / RECORD_FILE}: is no record of a result: reconstruct the scan again")
    try:
        shape = int(record["rows"]), int(record["columns"])
        pitch_um = float(record["pixel_pitch_um"])
        pages = len(record["frames"]) if is_video else 1
        rate_hz = float(record["rate_hz"]) if is_video else None
        title = str(record["name"])[:LONGEST_TITLE] or folder.name
    except (KeyError, TypeError, ValueError) as error:
        raise ViewError(f"{folder / RECORD_FILE}: lacks what a result says: reconstruct the scan again") from error
    heights = folder / (VIDEO_HEIGHTS if is_video else RESULT_HEIGHT)
    if min(shape) < 2 or pages < 1 or not 0.0 < pitch_um < MOST_PITCH_UM or not heights.is_file():
        raise ViewError(f"{folder}: holds no heights: reconstruct the scan again")
    if shape[0] * shape[1] > MOST_PIXELS:
        raise ViewError(f"{folder}: is larger than can be shown ({shape[1]} × {shape[0]}): show a part of it")
    scan = scan or _scan_around(folder)
    return Entry(
        key=key_of(folder),
        kind="video" if is_video else "result",
        title=(hit.part or title) if hit else title,
        heights=heights,
        shape=shape,
        pitch_um=pitch_um,
        pages=pages,
        rate_hz=rate_hz,
        scan=scan,
        hit=hit,
        record=record,
    )


def quick_look_entry(scan: Path, hit: Hit, pixel_pitch_um: float, columns: int) -> Entry:
    """The entry of a scan that has not been reconstructed: the device's own reduced height map.

    pixel_pitch_um, columns : of the raw frame

    Raises
    ------
    ViewError
        It has none.
    """
    heights = scan / QUICK_LOOK_FILE
    try:
        with tifffile.TiffFile(heights) as tiff:
            shape = tiff.pages.first.shape
    except (OSError, ValueError, tifffile.TiffFileError) as error:
        raise ViewError(f"{hit.scan_id}: has no quick look: reconstruct it to see it") from error
    if len(shape) != 2 or min(shape) < 2 or shape[0] * shape[1] > MOST_PIXELS:
        raise ViewError(f"{heights}: is no height map: pull the scan again")
    return Entry(
        key=key_of(scan),
        kind="quick look",
        title=hit.part or hit.scan_id,
        heights=heights,
        shape=(shape[0], shape[1]),
        pitch_um=pixel_pitch_um * columns / shape[1],
        scan=scan,
        hit=hit,
    )


def _scan_around(folder: Path) -> Path | None:
    """The scan bundle whose results/<name>/ this folder is."""
    scan = folder.resolve().parent.parent
    return scan if (scan / "scan.json").is_file() else None


def _record(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > _RECORD_BYTES:
            raise ViewError(f"{path}: is too large for a record: reconstruct the scan again")
        found = msgspec.json.decode(path.read_bytes())
    except OSError as error:
        raise ViewError(f"{path.parent}: holds no result that can be read: name a library or a result") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ViewError(f"{path}: is damaged: reconstruct the scan again") from error
    if not isinstance(found, dict):
        raise ViewError(f"{path}: is no record of a result: reconstruct the scan again")
    return found
