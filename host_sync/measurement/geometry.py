"""Lengths, angles and volumes of places and regions of a surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from device.surface.fields import Float32Array, Float64Array, MaskArray
from host_sync.errors import MeasurementError
from host_sync.measurement.skin_places import SkinPlaces


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle on the field, µm from the centre of the first pixel; its border belongs to it."""

    left_um: float
    top_um: float
    right_um: float
    bottom_um: float

    def pixels(self, shape: tuple[int, int], pitch_um: float) -> tuple[slice, slice]:
        """Rows and columns of the pixels inside.

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
        """The part of a surface inside it."""
        return z_um[self.pixels((z_um.shape[0], z_um.shape[1]), pitch_um)]


def between_places(z_um: Float32Array, places: SkinPlaces, start: Float64Array, end: Float64Array) -> dict[str, float]:
    """Lateral distance, height difference and distance in space, µm, and slope angle, degrees, between two places.

    start, end : (column, row) on the grid of pixels, µm; their heights are means of the valid pixels within one
        and a half pixels

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
    """Angle between the least-squares planes of two regions, degrees.

    places : of the pixels of each
    """
    return _between_normals_deg(*(_normal(*one) for one in zip((first, second), places, strict=True)))


def bend_deg(z_um: Float32Array, places: SkinPlaces) -> float:
    """Largest angle between the planes of opposite halves of a region, degrees; NaN where no half shows a plane."""
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
    """Void below and material above the plane through a region's border, µm³; largest depth and height, µm.

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
    """Heights above the plane through the used pixels, where they lie, µm."""
    across_um, down_um = places.at(z_um)
    a, b, c = _plane(across_um, down_um, np.where(used, z_um, np.float32(np.nan)))
    return np.asarray(z_um - (a * across_um + b * down_um + c), np.float32)


def _between_normals_deg(first: Float64Array, second: Float64Array) -> float:
    """Angle between two vectors of any length, degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second)))


def _normal(z_um: Float32Array, places: SkinPlaces) -> Float64Array:
    """Normal of the least-squares plane, of any length."""
    a, b, _ = _plane(*places.at(z_um), z_um)
    return np.array([a, b, 1.0])


def _plane(across: Float64Array, down: Float64Array, z_um: Float32Array) -> tuple[float, float, float]:
    """Slopes across and down, and height at the origin, of the plane through the valid pixels; µm."""
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
    near = z_um[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    if not np.isfinite(near).any():
        raise MeasurementError(f"the place ({place[0]:g}, {place[1]:g}) µm is masked: choose another")
    return float(np.nanmean(near))
