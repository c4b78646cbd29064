"""Entries of the viewer: a result, a video's result, a quick look, or the difference of two."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Final, Literal

import msgspec
import numpy as np

from device.quick_look.solver import HEIGHT_FILE as QUICK_LOOK_FILE
from device.surface import Float32Array
from host_sync.errors import UnreadableResult, ViewError
from host_sync.library.index import Hit
from host_sync.library.labels import Label
from host_sync.results.doubts import quick_look_doubts, result_doubts, video_doubts
from host_sync.results.field_file import read_field, read_samples, read_shape, read_stack_page
from host_sync.results.files import HEIGHT_FILE, HEIGHT_SIGMA_FILE, HEIGHTS_FILE, SAMPLES_FILE
from host_sync.results.reader import max_sample_values
from host_sync.results.record import MAX_PITCH_UM, MIN_PITCH_UM, Doubt, ResultRecord, SequenceRecord, read_listed_record

Kind = Literal["result", "video", "quick look", "difference"]

MAX_TITLE: Final = 200


class DifferenceRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A difference as it is stored beside its heights; units are in the names."""

    name: str
    first: str
    second: str
    shift_um: tuple[float, float]
    turn_deg: float
    offset_um: float
    tilt: tuple[float, float]
    residual_um: float
    median_um: float
    overlap_share: float
    agreement_share: float
    registered_by: str = ""
    shift_sigma_um: float | None = None
    warnings: tuple[str, ...]
    height_sigma_median_um: float | None


Record = ResultRecord | SequenceRecord | DifferenceRecord


@dataclass(frozen=True, slots=True)
class Entry:
    """Scan or result that can be opened.

    key : name in the page's requests; says nothing about the place on disk
    heights : file of the height maps
    shape : (H, W)
    pages : number of height maps in the file
    scan : directory of its scan bundle, if any
    hit : the scan's row in the library's index
    record : None for a quick look
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
    record: Record | None = None

    @property
    def reasons(self) -> tuple[Doubt, ...]:
        """Every reason to distrust the heights."""
        if isinstance(self.record, ResultRecord):
            return result_doubts(self.folder, self.record)
        if isinstance(self.record, SequenceRecord):
            return video_doubts(self.folder, self.record)
        if isinstance(self.record, DifferenceRecord):
            return tuple(Doubt("reconstruction", words) for words in self.record.warnings)
        return quick_look_doubts(self.scan) if self.scan is not None else ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """The reasons, a sentence each; those of a difference name the scan that they are of."""
        if isinstance(self.record, DifferenceRecord):
            return self.record.warnings
        return tuple(doubt.sentence for doubt in self.reasons)

    @property
    def folder(self) -> Path:
        """Folder of the heights and the files beside them."""
        return self.heights.parent

    def stamp(self) -> str:
        """Return a hash that changes when the heights on disk change.

        Raises
        ------
        ViewError
            They were removed.
        """
        try:
            facts = self.heights.stat()
        except OSError as error:
            raise ViewError(f"{self.title}: its heights were removed from the disk: open the library again") from error
        words = f"{self.heights.resolve()}:{facts.st_size}:{facts.st_mtime_ns}:{self.pitch_um}"
        return hashlib.sha256(words.encode(errors="surrogateescape")).hexdigest()[:32]


def key_of(path: Path) -> str:
    """Return the key of a path."""
    return hashlib.sha256(str(path.resolve()).encode(errors="surrogateescape")).hexdigest()[:16]


def result_entry(folder: Path, scan: Path | None = None, hit: Hit | None = None) -> Entry:
    """Return the entry of a result folder.

    Raises
    ------
    UnreadableResult
        It holds no record or heights, or they are damaged.
    """
    record = read_listed_record(folder)
    is_video = isinstance(record, SequenceRecord)
    heights = folder / (HEIGHTS_FILE if is_video else HEIGHT_FILE)
    if min(record.rows, record.columns) < 2 or not heights.is_file():
        raise UnreadableResult(f"{folder}: holds no heights: reconstruct the scan again")
    return Entry(
        key=key_of(folder),
        kind="video" if is_video else "result",
        title=_title(hit, record.name[:MAX_TITLE] or folder.name),
        heights=heights,
        shape=(record.rows, record.columns),
        pitch_um=record.pixel_pitch_um,
        pages=len(record.frames) if isinstance(record, SequenceRecord) else 1,
        rate_hz=record.rate_hz if isinstance(record, SequenceRecord) else None,
        scan=scan or _scan_around(folder),
        hit=hit,
        record=record,
    )


def quick_look_entry(scan: Path, hit: Hit, pixel_pitch_um: float, frame_shape: tuple[int, int]) -> Entry:
    """Return the entry of a scan without a result: the device's reduced height map.

    pixel_pitch_um, frame_shape : of the raw frame

    Raises
    ------
    UnreadableResult
        It has none, or it is damaged or larger than the frame.
    """
    heights = scan / QUICK_LOOK_FILE
    if not heights.is_file():
        raise UnreadableResult(f"{hit.scan_id}: has no quick look: reconstruct it to see it")
    shape = read_shape(heights)
    pitch_um = pixel_pitch_um * frame_shape[1] / shape[1]
    if (
        min(shape) < 2
        or shape[0] > frame_shape[0]
        or shape[1] > frame_shape[1]
        or not MIN_PITCH_UM <= pitch_um <= MAX_PITCH_UM
    ):
        raise UnreadableResult(f"{heights}: does not fit the scan's frame: pull the scan again")
    return Entry(
        key=key_of(scan),
        kind="quick look",
        title=_title(hit, hit.scan_id),
        heights=heights,
        shape=shape,
        pitch_um=pitch_um,
        scan=scan,
        hit=hit,
    )


def relabelled(entry: Entry, scan_id: str, label: Label) -> Entry:
    """Return the entry with a scan's new label, if it is of that scan."""
    if entry.hit is None or entry.hit.scan_id != scan_id:
        return entry
    hit = replace(entry.hit, name=label.name, tags=label.tags, note=label.note)
    own = entry.record.name[:MAX_TITLE] or entry.folder.name if entry.record else scan_id
    return replace(entry, hit=hit, title=_title(hit, own))


def _title(hit: Hit | None, own: str) -> str:
    """Return what lists call an entry: its label's name, else its part, else its own name."""
    return (hit.name or hit.part or own) if hit else own


def _scan_around(folder: Path) -> Path | None:
    """Return the scan bundle whose results/<name>/ this folder is."""
    scan = folder.resolve().parent.parent
    return scan if (scan / "scan.json").is_file() else None


# Height maps of entries; the last few stay in memory, because a page requests one in bands.

KEPT: Final = 3

MAX_HEIGHT_UM: Final = 1e6
"""Heights beyond this come from a damaged file; squared slopes would overflow."""


class Heights:
    """Reads height maps and the fields beside them, and keeps the last `KEPT`."""

    def __init__(self) -> None:
        self._held: OrderedDict[tuple[str, int | str], Float32Array] = OrderedDict()
        self._lock = Lock()

    def read(self, entry: Entry, page: int = 0) -> Float32Array:
        """Return the height map: float32 array of shape (H, W), µm, NaN where invalid or impossible; read only.

        Raises
        ------
        ViewError
            There is no such page.
        UnreadableResult
            The file is damaged or of another size than its record states.
        """
        if not 0 <= page < entry.pages:
            raise ViewError(f"{entry.title}: has no frame {page}: choose one from 0 to {entry.pages - 1}")
        return self._holding((entry.stamp(), page), lambda: _read(entry, page))

    def sigma(self, entry: Entry) -> Float32Array | None:
        """Return the standard uncertainty, float32 array of shape (H, W), µm; None when the entry has none.

        Raises
        ------
        UnreadableResult
            It is damaged or not as large as the height map.
        """
        path = entry.folder / HEIGHT_SIGMA_FILE
        if entry.kind not in {"result", "difference"} or not path.is_file():
            return None
        return self._holding((entry.stamp(), path.name), lambda: read_field(path, entry.shape))

    def samples(self, entry: Entry) -> Float32Array | None:
        """Monte Carlo samples of the height error, float32 array of shape (K, h, w), µm; None when there are none.

        Raises
        ------
        UnreadableResult
            They are damaged.
        """
        path = entry.folder / SAMPLES_FILE
        if entry.kind != "result" or not path.is_file():
            return None
        return self._holding((entry.stamp(), path.name), lambda: read_samples(path, max_sample_values(entry.shape)))

    def _holding(self, key: tuple[str, int | str], read: Callable[[], Float32Array]) -> Float32Array:
        with self._lock:
            if key not in self._held:
                self._held[key] = read()
                while len(self._held) > KEPT:
                    self._held.popitem(last=False)
            self._held.move_to_end(key)
            return self._held[key]


def _read(entry: Entry, page: int) -> Float32Array:
    if entry.kind == "video":
        z_um = read_stack_page(entry.heights, page, entry.shape)
    else:
        z_um = read_field(entry.heights, entry.shape)
    np.copyto(z_um, np.nan, where=~(np.abs(z_um) <= MAX_HEIGHT_UM))
    return z_um
