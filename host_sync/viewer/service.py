"""Answers the page's questions: joins catalogue, cache and heights.

The server calls these methods in threads, because they read files and compute; at most `HEAVY` compute at a time, which
bounds memory.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from threading import BoundedSemaphore
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np

from device.surface import Float32Array, HeightMap
from host_sync.errors import RegistrationRefused, ViewError
from host_sync.frames.frame_set import FrameSet
from host_sync.profile.profile_line import Line
from host_sync.render.shading import steep_slope
from host_sync.report.composing import origin_of
from host_sync.results.field_file import write_field
from host_sync.results.files import HEIGHT_SIGMA_FILE, SAMPLES_FILE
from host_sync.results.record import ResultRecord, SequenceRecord
from host_sync.viewer.cache import Cache, Level, level_count, padded_shape
from host_sync.viewer.catalogue import Catalogue
from host_sync.viewer.entry import DifferenceRecord, Entry, Heights, Record, key_of
from host_sync.viewer.responses import MeasuredLine, frame_picture, grey_frames, measure_line, sigma_picture, thumbnail

if TYPE_CHECKING:
    from host_sync.measurement.recipe import Recipe
    from host_sync.viewer.measuring import Measuring

HEAVY: Final = 2
SCREEN_SAMPLES: Final = 400
_DIFFERENCE: Final = 4
"""Version of a stored difference: another version in the cache is computed again."""

_DIFFERENCE_FILE: Final = "difference_um.tif"
_DIFFERENCE_RECORD: Final = "difference.json"


def _overview_of(entry: Entry) -> Path | None:
    """Return the file of the overview that `retrosync calibrate` drew, if the entry's calibration has one."""
    return origin_of(entry.folder, entry.record).overview if isinstance(entry.record, ResultRecord) else None


@dataclass(frozen=True, slots=True)
class NearPose:
    """Place of the second scan that a person states: displacement of the object, µm, and clockwise rotation, degrees.

    pinned : take it as it is, and do not look for the best place near to it
    """

    down_um: float
    right_um: float
    turn_deg: float = 0.0
    pinned: bool = False


class ViewerService:
    """Answers questions about entries.

    Parameters
    ----------
    catalogue : the entries
    cache_folder : may be deleted at any time
    frames : the frame set that the results were made from, if named
    """

    def __init__(self, catalogue: Catalogue, cache_folder: Path, frames: FrameSet | None = None) -> None:
        self.catalogue = catalogue
        self._heights = Heights()
        self._cache = Cache(cache_folder, self._heights)
        self._measuring: Measuring | None = None
        self._frames = {scan.name: scan for scan in frames.scans} if frames else {}
        self._turn = BoundedSemaphore(HEAVY)

    def level(self, key: str, page: int, level: int, first: int, last: int) -> Level:
        """Return rows of a level of an entry's pyramid."""
        with self._turn:
            return self._cache.level(self.catalogue.find(key), page, level, first, last)

    def thumbnail(self, key: str) -> bytes:
        """Return a small relief, WebP."""
        entry = self.catalogue.find(key)
        middle = entry.pages // 2
        with self._turn:
            return self._cache.file(
                entry, "thumbnail.webp", lambda: thumbnail(self._heights.read(entry, middle), entry.pitch_um)
            )

    def frame(self, key: str) -> bytes:
        """Return the entry's frame, JPEG."""
        entry = self.catalogue.find(key)
        with self._turn:
            return self._cache.file(entry, "frame.jpg", lambda: frame_picture(entry, self._frames.get(entry.title)))

    def calibration_overview(self, key: str) -> bytes:
        """Return the picture of the entry's calibration, PNG."""
        entry = self.catalogue.find(key)
        picture = _overview_of(entry)
        if picture is None:
            raise ViewError(f"{entry.title}: its calibration has no overview: reconstruct it with a file of calibrate")
        return picture.read_bytes()

    def sigma(self, key: str) -> Float32Array:
        """Return the reduced map of the standard uncertainty, µm."""
        entry = self.catalogue.find(key)
        with self._turn:
            found = self._heights.sigma(entry)
            if found is None:
                raise ViewError(f"{entry.title}: has no uncertainty: reconstruct it with this version")
            return sigma_picture(found)

    def profile(self, key: str, page: int, ends_px: tuple[float, float, float, float]) -> MeasuredLine:
        """Return the heights along a line.

        ends_px : row and column of the start, row and column of the end
        """
        entry = self.catalogue.find(key)
        row_0, column_0, row_1, column_1 = (end * entry.pitch_um for end in ends_px)
        line = Line((column_0, row_0), (column_1, row_1))
        with self._turn:
            samples_um = self._heights.samples(entry)
            sigma_um = self._heights.sigma(entry) if samples_um is None else None
            return measure_line(self._heights.read(entry, page), entry.pitch_um, line, samples_um, sigma_um)

    def measure(self, key: str, page: int, recipe: Recipe, *, samples: bool) -> dict[str, Any]:
        """Return the measurement of an entry by a recipe, as the page shows it."""
        from host_sync.viewer.measuring import Measuring

        entry = self.catalogue.find(key)
        with self._turn:
            self._measuring = self._measuring or Measuring(self._heights)
            return self._measuring.measure(entry, page, recipe, samples=samples)

    def height(self, key: str, page: int, row: int, column: int) -> float:
        """Return one pixel's height, µm; NaN where invalid."""
        entry = self.catalogue.find(key)
        z_um = self._heights.read(entry, page)
        if not (0 <= row < z_um.shape[0] and 0 <= column < z_um.shape[1]):
            raise ViewError("that place is outside the height map: point inside it")
        return float(z_um[row, column])

    def facts(self, key: str) -> dict[str, Any]:
        """Return the facts that the page needs before it draws."""
        entry = self.catalogue.find(key)
        with self._turn:
            z_um = self._heights.read(entry, entry.pages // 2)
            sample = z_um[:: max(1, z_um.shape[0] // 500), :: max(1, z_um.shape[1] // 500)]
            steep = steep_slope(HeightMap(z_um, entry.pitch_um), SCREEN_SAMPLES)
        known = sample[np.isfinite(sample)]
        low, high = (float(end) for end in np.percentile(known, [0.1, 99.9])) if known.size else (0.0, 1.0)
        if entry.kind == "video":
            low, high = _stated_range(entry.record) or (low, high)
        return {
            "levels": level_count(entry.shape),
            "padded": padded_shape(entry.shape),
            "low_um": low,
            "high_um": max(high, low + 1e-3),
            "steep": steep,
            "masked_share": float(np.isnan(sample).mean()),
            "has_frame": entry.kind != "difference" and (entry.scan is not None or entry.title in self._frames),
            "has_sigma": entry.kind in {"result", "difference"} and (entry.folder / HEIGHT_SIGMA_FILE).is_file(),
            "has_calibration_overview": _overview_of(entry) is not None,
            "has_samples": entry.kind == "result" and (entry.folder / SAMPLES_FILE).is_file(),
        }

    def compare(self, first_key: str, second_key: str, near: NearPose | None = None) -> Entry:
        """Return the difference of two entries, second minus first, as an entry of its own.

        near : the shift that a person gave, if any

        Raises
        ------
        ViewError
            They are the same, show nothing in common, or their registration cannot be trusted.
        """
        first, second = self.catalogue.find(first_key), self.catalogue.find(second_key)
        if first.key == second.key:
            raise ViewError("a scan cannot be compared with itself: choose another")
        said = f"{first.title}{first.doubts}:{second.title}{second.doubts}"
        words = f"{_DIFFERENCE}:{first.stamp()}:{second.stamp()}:{near}:{said}"
        name = hashlib.sha256(words.encode(errors="surrogateescape")).hexdigest()[:32]
        folder = self._cache.folder(name)
        with self._turn:
            record = _stored_difference(folder)
            if record is None:
                record = self._make_difference(first, second, folder, near)
        entry = replace(
            first,
            key=key_of(folder),
            kind="difference",
            title=f"{second.title} minus {first.title}",
            heights=folder / _DIFFERENCE_FILE,
            pages=1,
            rate_hz=None,
            hit=None,
            scan=None,
            record=record,
        )
        self.catalogue.add_derived(entry)
        return entry

    def refused_pose(self, first_key: str, refused: RegistrationRefused) -> dict[str, float]:
        """Return the best pose of a registration that was refused, for a person to start from."""
        pitch_um = self.catalogue.find(first_key).pitch_um
        return {
            "down_um": refused.down_px * pitch_um,
            "right_um": refused.right_px * pitch_um,
            "turn_deg": float(np.degrees(refused.turn_rad)),
        }

    def _make_difference(self, first: Entry, second: Entry, folder: Path, near: NearPose | None) -> DifferenceRecord:
        # Compiled code is loaded when it is first needed, so that the list appears at once.
        from device.align import Pose
        from host_sync.registration.difference import difference

        pose = None
        if near is not None:
            down, right = (um / first.pitch_um for um in (near.down_um, near.right_um))
            pose = Pose(down, right, float(np.radians(near.turn_deg)))
        found = difference(
            HeightMap(self._heights.read(first, first.pages // 2), first.pitch_um),
            HeightMap(self._heights.read(second, second.pages // 2), second.pitch_um),
            (self._heights.sigma(first), self._heights.sigma(second)),
            frames=None if pose else grey_frames(first, second),
            near=pose,
            pinned=near is not None and near.pinned,
        )
        sigma_um = found.sigma_um
        record = DifferenceRecord(
            name="difference",
            first=first.key,
            second=second.key,
            shift_um=found.shift_um,
            turn_deg=found.turn_deg,
            offset_um=found.offset_um,
            tilt=found.tilt,
            residual_um=found.residual_um,
            median_um=found.median_um,
            overlap_share=found.overlap_share,
            agreement_share=found.registration.agreement,
            registered_by=found.registration.by,
            shift_sigma_um=found.shift_sigma_um,
            warnings=(
                *((found.warning,) if found.warning else ()),
                *(f"{entry.title}: {doubt}" for entry in (first, second) for doubt in entry.doubts),
            ),
            height_sigma_median_um=None if sigma_um is None else float(np.nanmedian(sigma_um)),
        )
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_field(folder / _DIFFERENCE_FILE, found.z_um, first.pitch_um, "height difference, um")
            if sigma_um is not None:
                write_field(folder / HEIGHT_SIGMA_FILE, sigma_um, first.pitch_um, "standard uncertainty, um")
            (folder / _DIFFERENCE_RECORD).write_bytes(msgspec.json.encode(record))
        except OSError as error:
            raise ViewError(
                f"{folder}: the cache cannot be written: free space, or name another with --cache"
            ) from error
        return record


def _stored_difference(folder: Path) -> DifferenceRecord | None:
    try:
        record = msgspec.json.decode((folder / _DIFFERENCE_RECORD).read_bytes(), type=DifferenceRecord)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return None
    return record if (folder / _DIFFERENCE_FILE).is_file() else None


def _stated_range(record: Record | None) -> tuple[float, float] | None:
    """Return the lowest and highest height of all frames of a video, µm, where its record states them."""
    ends = record.colour_range_um if isinstance(record, SequenceRecord) else None
    return ends if ends is not None and ends[0] < ends[1] else None
