"""Lengths, angles and volumes of places and regions of a surface."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap, MaskArray
from host_sync.errors import MeasurementError
from host_sync.measurement.recipe import MaskTable
from host_sync.profile.profile_line import Line
from host_sync.results.record import ResultRecord


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle on the field, µm from the centre of the first pixel; its border belongs to it."""

    left_um: float
    top_um: float
    right_um: float
    bottom_um: float

    def pixels(self, shape: tuple[int, int], pitch_um: float) -> tuple[slice, slice]:
        """Return rows and columns of the pixels inside.

        Raises
        ------
        MeasurementError
            There are none.
        """
        low = np.ceil(np.array([self.top_um, self.left_um]) / pitch_um - 1e-9)
        high = np.floor(np.array([self.bottom_um, self.right_um]) / pitch_um + 1e-9) + 1.0
        low, high = np.clip(low, 0, shape).astype(int), np.clip(high, 0, shape).astype(int)
        if (high - low < 2).any():
            raise MeasurementError(
                f"the region {self.left_um:g} {self.top_um:g} {self.right_um:g} {self.bottom_um:g} µm holds fewer than "
                f"two pixels in a direction; the field is {(shape[1] - 1) * pitch_um:.0f} x "
                f"{(shape[0] - 1) * pitch_um:.0f} µm: give left, top, right, bottom inside it"
            )
        return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))

    def cut(self, z_um: Float32Array, pitch_um: float) -> Float32Array:
        """Return the part of a surface inside it."""
        return z_um[self.pixels((z_um.shape[0], z_um.shape[1]), pitch_um)]


def between_places(z_um: Float32Array, places: SkinPlaces, start: Float64Array, end: Float64Array) -> dict[str, float]:
    """Return lateral distance, height difference, distance in space (µm) and slope angle (°) of two places.

    start, end : (column, row) on the grid of pixels, µm; their heights are those of the plane through the valid
        pixels within one and a half pixels

    Raises
    ------
    MeasurementError
        A place is outside the field, or no pixel near it is valid.
    """
    heights = [_height_at(z_um, places.pitch_um, place) for place in (start, end)]
    start, end = places.of_seen(np.stack([start, end]), np.array(heights))
    across_um = float(np.hypot(*(end - start)))
    rise_um = heights[1] - heights[0]
    return {
        "along the skin": across_um,
        "in height": rise_um,
        "in space": float(np.hypot(across_um, rise_um)),
        "slope angle": float(np.degrees(np.arctan2(rise_um, across_um))),
    }


def between_planes_deg(first: Float32Array, second: Float32Array, places: tuple[SkinPlaces, SkinPlaces]) -> float:
    """Return the angle between the least-squares planes of two regions, degrees.

    places : of the pixels of each
    """
    return _between_normals_deg(*(_normal(*one) for one in zip((first, second), places, strict=True)))


def bend_deg(z_um: Float32Array, places: SkinPlaces) -> float:
    """Return the largest angle between the planes of opposite halves of a region; NaN where none show one."""
    across_um, down_um = places.at(z_um)
    largest = np.nan
    for axis in (0, 1):
        parts = [np.array_split(part, 2, axis) for part in (across_um, down_um, z_um)]
        try:
            normals = [np.array([*_plane(*half)[:2], 1.0]) for half in zip(*parts, strict=True)]
        except MeasurementError:
            continue
        largest = np.fmax(largest, _between_normals_deg(*normals))
    return float(largest)


def pit_volumes(z_um: Float32Array, places: SkinPlaces, border_px: int) -> dict[str, float]:
    """Return the void below and material above the plane through a region's border, µm³; largest depth and height, µm.

    Masked pixels are not counted.

    border_px : width of the border

    Raises
    ------
    MeasurementError
        The border does not determine a plane.
    """
    border = np.isfinite(z_um)
    border[border_px:-border_px, border_px:-border_px] = False
    heights = over_plane(z_um, border, places)
    known = np.isfinite(heights)
    seen = heights[known].astype(np.float64)
    below, above = np.minimum(seen, 0.0), np.maximum(seen, 0.0)
    area_um2 = places.areas_um2(z_um)[known]
    return {
        "void volume": -float((below * area_um2).sum()),
        "material volume": float((above * area_um2).sum()),
        "largest depth": -float(below.min()),
        "largest height": float(above.max()),
    }


def over_plane(z_um: Float32Array, used: MaskArray, places: SkinPlaces) -> Float32Array:
    """Return heights above the plane through the used pixels, where they lie, µm."""
    across_um, down_um = places.at(z_um)
    a, b, c = _plane(across_um, down_um, np.where(used, z_um, np.float32(np.nan)))
    return np.asarray(z_um - (a * across_um + b * down_um + c), np.float32)


def _between_normals_deg(first: Float64Array, second: Float64Array) -> float:
    """Return the angle between two vectors of any length, degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second)))


def _normal(z_um: Float32Array, places: SkinPlaces) -> Float64Array:
    """Return the normal of the least-squares plane, of any length."""
    a, b, _ = _plane(*places.at(z_um), z_um)
    return np.array([a, b, 1.0])


def _plane(across: Float64Array, down: Float64Array, z_um: Float32Array) -> tuple[float, float, float]:
    """Return slopes across and down, and height at the origin, of the plane through the valid pixels; µm."""
    known = np.isfinite(z_um)
    design = np.stack([across[known], down[known], np.ones(known.sum())], axis=-1).astype(np.float64)
    solution, _, rank, _ = np.linalg.lstsq(design, z_um[known].astype(np.float64), rcond=None)
    if rank < 3:
        raise MeasurementError(f"{len(design)} valid pixels do not determine a plane: widen the region")
    a, b, c = (float(value) for value in solution)
    return a, b, c


def _height_at(z_um: Float32Array, pitch_um: float, place: Float64Array) -> float:
    column, row = (int(value) for value in np.rint(place / pitch_um))
    if not (0 <= row < z_um.shape[0] and 0 <= column < z_um.shape[1]):
        raise MeasurementError(f"the place ({place[0]:g}, {place[1]:g}) µm is outside the field: move it inside")
    top, left = max(row - 1, 0), max(column - 1, 0)
    near = z_um[top : row + 2, left : column + 2]
    if not np.isfinite(near).any():
        raise MeasurementError(f"the place ({place[0]:g}, {place[1]:g}) µm is masked: choose another")
    down, across = (np.arange(size) + first for size, first in zip(near.shape, (top, left), strict=True))
    away = np.meshgrid(across * pitch_um - place[0], down * pitch_um - place[1])
    try:
        return _plane(away[0], away[1], near)[2]
    except MeasurementError:  # the valid neighbours lie on a line
        return float(np.nanmean(near))


# Places on the skin of the pixels of a height map.
#
# A camera that is not far away sees raised skin larger: what stands z over the untouched skin lies nearer to the middle
# of the field than its pixel does there, by the share z / h, where h is the height of the camera's pupil
# (`device/balls/sphere.py`).

MIN_FRACTION: Final = 0.2
"""Skin that is said to stand nearer to the camera than this share of its height is taken to stand there."""


@dataclass(frozen=True, slots=True)
class SkinPlaces:
    """Places of pixels, µm right and down of the first one.

    pitch_um : of pixels on untouched skin
    middle_um : column and row below the camera
    nearness_per_um : 1 over the height of the camera's pupil above untouched skin; 0 far away
    level : what levelling took off the heights: µm at the middle, and per µm right and down of it
    """

    pitch_um: float
    middle_um: tuple[float, float] = (0.0, 0.0)
    nearness_per_um: float = 0.0
    level: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, record: ResultRecord) -> SkinPlaces:
        """Return the places of a result's pixels."""
        pitch_um = record.pixel_pitch_um
        middle_um = 0.5 * pitch_um * (record.columns - 1), 0.5 * pitch_um * (record.rows - 1)
        return cls(pitch_um, middle_um, 0.0 if record.pupil_height_mm is None else 1e-3 / record.pupil_height_mm)

    def levelled(self, zero_um: float, down: float, across: float) -> SkinPlaces:
        """Return the places for heights from which a plane was subtracted.

        zero_um : height of the plane at the middle of the field
        down, across : its rise per pixel, µm
        """
        return replace(self, level=(zero_um, across / self.pitch_um, down / self.pitch_um))

    def of_part(self, rows: slice, columns: slice) -> SkinPlaces:
        """Return the places of a part of the field, from the part's first pixel."""
        across_um, down_um = self.middle_um
        left_um, top_um = columns.start * self.pitch_um, rows.start * self.pitch_um
        return replace(self, middle_um=(across_um - left_um, down_um - top_um))

    def at(self, z_um: Float32Array) -> tuple[Float64Array, Float64Array]:
        """Return distances of pixels from the first one, to the right and down, µm: float64 arrays of shape (H, W)."""
        x, y = self._from_middle(z_um.shape)
        shares = self._shares(x, y, z_um)
        return self.middle_um[0] + x * shares, self.middle_um[1] + y * shares

    def areas_um2(self, z_um: Float32Array) -> Float64Array:
        """Return the area of the skin in each pixel, as seen from above, float64 array of shape (H, W), µm²."""
        if self.nearness_per_um == 0.0:
            return np.full(z_um.shape, self.pitch_um**2)
        x, y = self._from_middle(z_um.shape)
        shares = self._shares(x, y, z_um)
        down, across = np.gradient(z_um.astype(np.float64), self.pitch_um)
        rise = x * (across + self.level[1]) + y * (down + self.level[2])
        # Skin that rises outwards is pushed together as it is seen nearer to the middle.
        return np.asarray(self.pitch_um**2 * shares * (shares - self.nearness_per_um * np.nan_to_num(rise)))

    def of_seen(self, places_um: Float64Array, z_um: Float64Array | float) -> Float64Array:
        """Return where skin lies that is seen at (column, row) on the grid of pixels: shape (..., 2), µm.

        z_um : its heights, of shape (...); where one is not known the place is not
        """
        middle = np.array(self.middle_um)
        from_middle = places_um - middle
        shares = self._shares(from_middle[..., 0], from_middle[..., 1], z_um)
        return np.asarray(middle + from_middle * shares[..., None])

    def _from_middle(self, shape: tuple[int, ...]) -> tuple[Float64Array, Float64Array]:
        """Return the right of the camera, shape (W,), and below it, shape (H, 1), µm."""
        rows, columns = (np.arange(side, dtype=np.float64) * self.pitch_um for side in shape)
        return np.asarray(columns - self.middle_um[0]), np.asarray(rows - self.middle_um[1])[:, None]

    def _shares(self, x: Float64Array, y: Float64Array, z_um: Float32Array | Float64Array | float) -> Float64Array:
        """Return lengths on skin of these heights over what they would be untouched."""
        zero_um, across, down = self.level
        over_skin_um = np.asarray(z_um, np.float64) + (zero_um + across * x + down * y)
        return np.maximum(1.0 - self.nearness_per_um * over_skin_um, MIN_FRACTION)


# Footprint of a measurand on the field: points all over it, for the doubts that hold for parts of the field.

ALONG: Final = 64
ACROSS: Final = 8


def field_places(shape: tuple[int, int]) -> Float64Array:
    """Return the row and column, px, of points all over a field of `shape` (H, W): float64 array of shape (N, 2)."""
    return _grid(0.0, 0.0, shape[0] - 1.0, shape[1] - 1.0)


def region_places(regions: Iterable[Region], pitch_um: float) -> Float64Array:
    """Return the row and column, px, of points all over the regions: float64 array of shape (N, 2)."""
    parts = [
        _grid(*(place / pitch_um for place in (one.top_um, one.left_um, one.bottom_um, one.right_um)))
        for one in regions
    ]
    return np.concatenate(parts)


def line_places(line: Line, pitch_um: float) -> Float64Array:
    """Return the row and column, px, of points all over a line of some width: float64 array of shape (N, 2)."""
    start, end = (np.array(place[::-1]) / pitch_um for place in (line.start_um, line.end_um))
    along = np.linspace(start, end, ALONG)
    way = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
    offsets = np.linspace(-0.5, 0.5, ACROSS if line.width_um else 1) * line.width_um / pitch_um
    places = along[:, None] + offsets[:, None] * np.array([-way[1], way[0]])
    return np.asarray(places.reshape(-1, 2), np.float64)


def share_at(mask: MaskArray | None, places: Float64Array) -> float | None:
    """Return the fraction of the places at which a mask of shape (H, W) holds; None without a mask."""
    if mask is None:
        return None
    row, column = (np.clip(np.rint(places[:, axis]), 0, mask.shape[axis] - 1).astype(np.intp) for axis in (0, 1))
    return float(mask[row, column].mean())


def reaches_beyond(shape: tuple[int, int], places: Float64Array) -> bool:
    """Return whether places lie more than a pixel outside of a field of `shape` (H, W)."""
    return bool(len(places) and ((places < -1.0) | (places > shape)).any())


def _grid(top: float, left: float, bottom: float, right: float) -> Float64Array:
    row, column = np.meshgrid(np.linspace(top, bottom, ALONG), np.linspace(left, right, ALONG), indexing="ij")
    return np.stack([row.ravel(), column.ravel()], axis=-1)


# Places that a person left out of a measurement: strokes of a brush over the field.

SHIFT = 6
"""Binary places of OpenCV's drawing, 1/64 of a pixel."""

MAX_WIDTH_PX: Final = 32_000
"""OpenCV draws no wider line."""


def painted(strokes: Sequence[MaskTable], shape: tuple[int, int], pitch_um: float) -> MaskArray:
    """Return True where a stroke lies: bool array of shape (H, W)."""
    mask = np.zeros(shape, np.uint8)
    for stroke in strokes:
        places = np.rint(np.array(stroke.points_um) / pitch_um * 2**SHIFT).astype(np.int64)
        limit = 2**SHIFT * 4 * max(shape)
        places = np.clip(places, -limit, limit).astype(np.int32)
        width = max(1, round(min(stroke.width_um / pitch_um, 2.0 * sum(shape), MAX_WIDTH_PX)))
        if len(places) > 1:
            cv2.polylines(mask, [places[:, None]], isClosed=False, color=1, thickness=width, shift=SHIFT)
        for place in places:
            cv2.circle(mask, tuple(place), round(width * 2 ** (SHIFT - 1)), 1, cv2.FILLED, shift=SHIFT)
    return mask.astype(np.bool_)


def without(height: HeightMap, mask: MaskArray) -> HeightMap:
    """Return the height map, NaN under the mask."""
    z_um: Float32Array = np.where(mask, np.float32(np.nan), height.z_um).astype(np.float32)
    return HeightMap(z_um, height.pitch_um)
