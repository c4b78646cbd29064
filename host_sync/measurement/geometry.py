"""Lengths, angles and volumes of places and regions of a surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from device.surface.fields import Float32Array, Float64Array, MaskArray
from host_sync.errors import MeasurementError


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


def between_places(z_um: Float32Array, pitch_um: float, start: Float64Array, end: Float64Array) -> dict[str, float]:
    """Lateral distance, height difference and distance in space, µm, and slope angle, degrees, between two places.

    start, end : (column, row), µm; their heights are means of the valid pixels within one and a half pixels

    Raises
    ------
    MeasurementError
        A place is outside the field, or no pixel near it is valid.
    """
    heights = [_height_at(z_um, pitch_um, place) for place in (start, end)]
    across_um = float(np.hypot(*(end - start)))
    rise_um = heights[1] - heights[0]
    return {
        "along the skin": across_um,
        "in height": rise_um,
        "in space": float(np.hypot(across_um, rise_um)),
        "slope angle": float(np.degrees(np.arctan2(rise_um, across_um))),
    }


def between_planes_deg(first: Float32Array, second: Float32Array, pitch_um: float) -> float:
    """Angle between the least-squares planes of two regions, degrees."""
    normals = [np.array([*_plane(part)[:2], pitch_um]) for part in (first, second)]
    cosine = normals[0] @ normals[1] / np.linalg.norm(normals[0]) / np.linalg.norm(normals[1])
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def pit_volumes(z_um: Float32Array, pitch_um: float, border_px: int) -> dict[str, float]:
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
    heights = _over_plane(z_um, border)
    seen = heights[np.isfinite(heights)].astype(np.float64)
    below, above = np.minimum(seen, 0.0), np.maximum(seen, 0.0)
    return {
        "void volume": -float(below.sum()) * pitch_um**2,
        "material volume": float(above.sum()) * pitch_um**2,
        "largest depth": -float(below.min()),
        "largest height": float(above.max()),
    }


def _over_plane(z_um: Float32Array, used: MaskArray) -> Float32Array:
    """Heights above the plane through the used pixels."""
    a, b, c = _plane(np.where(used, z_um, np.float32(np.nan)))
    rows, columns = (np.arange(side) for side in z_um.shape)
    return np.asarray(z_um - (a * columns + b * rows[:, None] + c), np.float32)


def _plane(z_um: Float32Array) -> tuple[float, float, float]:
    """Slope per column and per row, and height at the first pixel, of the plane through the valid pixels; µm."""
    row, column = np.nonzero(np.isfinite(z_um))
    design = np.stack([column, row, np.ones(row.size)], axis=-1).astype(np.float64)
    solution, _, rank, _ = np.linalg.lstsq(design, z_um[row, column].astype(np.float64), rcond=None)
    if rank < 3:
        raise MeasurementError(f"{row.size} valid pixels do not determine a plane: widen the region")
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
