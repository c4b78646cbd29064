"""What the page can ask for, apart from how it asks: one object that joins catalogue, cache and heights.

All methods read files or compute, so that the server calls them in threads; `HEAVY` of them at a time, which bounds
memory.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any, Final

import msgspec
import numpy as np

from device.surface import Float32Array, HeightMap
from host_sync.errors import ViewError
from host_sync.frame_set import FrameSet
from host_sync.viewer.cache import Cache
from host_sync.viewer.catalogue import Catalogue
from host_sync.viewer.entry import Entry, key_of
from host_sync.viewer.heights import DRAWS_FILE, SIGMA_FILE, Heights
from host_sync.viewer.pictures import frame_picture, sigma_picture, thumbnail
from host_sync.viewer.profile import Line, Profile, profile
from host_sync.viewer.pyramid import Level, level_count, padded_shape

HEAVY: Final = 2
_DIFFERENCE: Final = 2
"""Version of a stored difference: what the cache holds of another is made anew."""


class Desk:
    """Answers questions about entries.

    Parameters
    ----------
    catalogue : what there is
    cache_folder : may be deleted at any time
    frames : the frame set whose scans the results are of, if it was named
    """

    def __init__(self, catalogue: Catalogue, cache_folder: Path, frames: FrameSet | None = None) -> None:
        self.catalogue = catalogue
        self._heights = Heights()
        self._cache = Cache(cache_folder, self._heights)
        self._frames = {scan.name: scan for scan in frames.scans} if frames else {}
        self._turns = BoundedSemaphore(HEAVY)

    def level(self, key: str, page: int, level: int, first: int, last: int) -> Level:
        """Rows of a level of an entry's pyramid."""
        with self._turn():
            return self._cache.level(self.catalogue.find(key), page, level, first, last)

    def thumbnail(self, key: str) -> bytes:
        """A small relief, WebP."""
        entry = self.catalogue.find(key)
        middle = entry.pages // 2
        with self._turn():
            return self._cache.file(
                entry, "thumbnail.webp", lambda: thumbnail(self._heights.read(entry, middle), entry.pitch_um)
            )

    def frame(self, key: str) -> bytes:
        """The entry's frame, JPEG."""
        entry = self.catalogue.find(key)
        with self._turn():
            return self._cache.file(entry, "frame.jpg", lambda: frame_picture(entry, self._frames.get(entry.title)))

    def sigma(self, key: str) -> Float32Array:
        """The reduced map of ±, µm."""
        entry = self.catalogue.find(key)
        with self._turn():
            found = self._heights.beside(entry, SIGMA_FILE, 2)
            if found is None:
                raise ViewError(f"{entry.title}: states no ±: reconstruct it with this version")
            return sigma_picture(found)

    def profile(self, key: str, page: int, line: Line) -> Profile:
        """The heights along a line."""
        entry = self.catalogue.find(key)
        with self._turn():
            draws_um = self._heights.beside(entry, DRAWS_FILE, 3)
            sigma_um = self._heights.beside(entry, SIGMA_FILE, 2) if draws_um is None else None
            return profile(self._heights.read(entry, page), entry.pitch_um, line, draws_um, sigma_um)

    def height(self, key: str, page: int, row: int, column: int) -> float:
        """One pixel's height, µm; NaN where invalid."""
        entry = self.catalogue.find(key)
        z_um = self._heights.read(entry, page)
        if not (0 <= row < z_um.shape[0] and 0 <= column < z_um.shape[1]):
            raise ViewError("that place is beside the height map: point inside it")
        return float(z_um[row, column])

    def facts(self, key: str) -> dict[str, Any]:
        """What the page must know before it draws."""
        entry = self.catalogue.find(key)
        with self._turn():
            z_um = self._heights.read(entry, entry.pages // 2)
            sample = z_um[:: max(1, z_um.shape[0] // 500), :: max(1, z_um.shape[1] // 500)]
            steep = _steep(z_um, entry.pitch_um)
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
            "has_sigma": entry.kind in {"result", "difference"} and (entry.folder / SIGMA_FILE).is_file(),
            "has_draws": entry.kind == "result" and (entry.folder / DRAWS_FILE).is_file(),
        }

    def compare(self, first_key: str, second_key: str) -> Entry:
        """The difference of two entries, second minus first, as an entry of its own.

        Raises
        ------
        ViewError
            They are the same, or show nothing in common.
        """
        first, second = self.catalogue.find(first_key), self.catalogue.find(second_key)
        if first.key == second.key:
            raise ViewError("a scan does not differ from itself: choose another to compare it with")
        name = hashlib.sha256(f"{_DIFFERENCE}:{first.stamp()}:{second.stamp()}".encode()).hexdigest()[:32]
        folder = self._cache.folder(name)
        with self._turn():
            record = _stored_difference(folder)
            if record is None:
                record = self._make_difference(first, second, folder)
        entry = replace(
            first,
            key=key_of(folder),
            kind="difference",
            title=f"{second.title} minus {first.title}",
            heights=folder / "difference_um.tif",
            pages=1,
            rate_hz=None,
            hit=None,
            scan=None,
            record=record,
        )
        self.catalogue.keep(entry)
        return entry

    def _make_difference(self, first: Entry, second: Entry, folder: Path) -> dict[str, Any]:
        # Compiled code is loaded when it is first needed: the list is to be there at once.
        from host_sync.reconstruction.results import write_field
        from host_sync.viewer.registration import difference

        found = difference(
            HeightMap(self._heights.read(first, first.pages // 2), first.pitch_um),
            HeightMap(self._heights.read(second, second.pages // 2), second.pitch_um),
            (self._heights.beside(first, SIGMA_FILE, 2), self._heights.beside(second, SIGMA_FILE, 2)),
        )
        sigma_um = found.sigma_um
        record = {
            "name": "difference",
            "first": first.key,
            "second": second.key,
            "shift_um": found.shift_um,
            "turn_deg": found.turn_deg,
            "offset_um": found.offset_um,
            "tilt": found.tilt,
            "residual_um": found.residual_um,
            "median_um": found.median_um,
            "overlap_share": found.overlap_share,
            "agreement_share": found.agreement,
            "warnings": [found.doubt] if found.doubt else [],
            "height_sigma_median_um": None if sigma_um is None else float(np.nanmedian(sigma_um)),
        }
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_field(folder / "difference_um.tif", found.z_um, first.pitch_um, "height difference, um")
            if sigma_um is not None:
                write_field(folder / SIGMA_FILE, sigma_um, first.pitch_um, "standard uncertainty, um")
            (folder / "difference.json").write_bytes(msgspec.json.encode(record))
        except OSError as error:
            raise ViewError(
                f"{folder}: the cache cannot be written: free space, or name another with --cache"
            ) from error
        return record

    @contextmanager
    def _turn(self) -> Iterator[None]:
        with self._turns:
            yield


def _stored_difference(folder: Path) -> dict[str, Any] | None:
    try:
        record = msgspec.json.decode((folder / "difference.json").read_bytes(), type=dict[str, Any])
    except (OSError, msgspec.DecodeError):
        return None
    return record if (folder / "difference_um.tif").is_file() else None


def _stated_range(record: dict[str, Any]) -> tuple[float, float] | None:
    """What the heights of all a video's frames span, µm, when its record says so."""
    ends = record.get("colour_range_um")
    if not isinstance(ends, list) or len(ends) != 2 or not all(isinstance(end, int | float) for end in ends):
        return None
    return (float(ends[0]), float(ends[1])) if np.isfinite(ends).all() and ends[0] < ends[1] else None


def _steep(z_um: Float32Array, pitch_um: float) -> float:
    """Slope that few pixels exceed, as the level shows it that fills a screen; nought when none is valid."""
    step = max(1, z_um.shape[1] // 400)
    here = z_um[:-1:step, :-1:step]
    across, down = z_um[:-1:step, 1::step], z_um[1::step, :-1:step]
    rows, columns = (min(sizes) for sizes in zip(here.shape, across.shape, down.shape, strict=True))
    here, across, down = (one[:rows, :columns] for one in (here, across, down))
    steep = np.hypot(across - here, down - here) / pitch_um
    known = steep[np.isfinite(steep)]
    return float(np.percentile(known, 97.0)) if known.size else 0.0
