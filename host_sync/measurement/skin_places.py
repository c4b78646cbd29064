"""Where on the skin the pixels of a height map lie.

A camera that is not far away sees raised skin larger: what stands z over the untouched skin lies nearer to the middle
of the field, by z over the camera's height, than its pixel does there (`device/balls/viewpoint.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.surface.fields import Float32Array, Float64Array
from host_sync.results.record import ResultRecord

MIN_SHARE: Final = 0.2
"""Skin that is said to stand nearer to the camera than this share of its height is taken to stand there."""


@dataclass(frozen=True, slots=True)
class SkinPlaces:
    """Places of pixels, µm right and down of the first one.

    pitch_um : of pixels on untouched skin
    middle_um : column and row below the camera
    nearness_per_um : 1 over the height of the camera's pupil above untouched skin; 0 far away
    """

    pitch_um: float
    middle_um: tuple[float, float] = (0.0, 0.0)
    nearness_per_um: float = 0.0

    @classmethod
    def of(cls, record: ResultRecord) -> SkinPlaces:
        """Those of a result."""
        if record.pupil_height_mm is None:
            return cls(record.pixel_pitch_um)
        middle_um = (0.5 * record.pixel_pitch_um * (side - 1) for side in (record.columns, record.rows))
        across_um, down_um = middle_um
        return cls(record.pixel_pitch_um, (across_um, down_um), 1e-3 / record.pupil_height_mm)

    def of_part(self, rows: slice, columns: slice) -> SkinPlaces:
        """Those of a part of the field, from the part's first pixel."""
        across_um, down_um = self.middle_um
        left_um, top_um = columns.start * self.pitch_um, rows.start * self.pitch_um
        return replace(self, middle_um=(across_um - left_um, down_um - top_um))

    def shares(self, z_um: Float32Array) -> Float64Array:
        """Lengths on skin of these elevations over what they would be untouched, of the same shape."""
        return np.maximum(1.0 - self.nearness_per_um * np.asarray(z_um, np.float64), MIN_SHARE)

    def share(self, z_um: float) -> float:
        """The same of one elevation; 1 where it is not known."""
        return max(1.0 - self.nearness_per_um * z_um, MIN_SHARE) if np.isfinite(z_um) else 1.0

    def at(self, z_um: Float32Array) -> tuple[Float64Array, Float64Array]:
        """Right and down of the first pixel, of each pixel of a height map: float64 arrays of shape (H, W), µm."""
        row, column = (index * self.pitch_um for index in np.indices(z_um.shape))
        shares = self.shares(z_um)
        across_um, down_um = self.middle_um
        return across_um + (column - across_um) * shares, down_um + (row - down_um) * shares

    def areas_um2(self, z_um: Float32Array) -> Float64Array:
        """Area of the skin in each pixel, as seen from above, float64 array of shape (H, W), µm²."""
        shares = self.shares(z_um)
        (middle_um, middle_down_um), (rows, columns) = self.middle_um, np.indices(z_um.shape) * self.pitch_um
        down, across = np.gradient(z_um.astype(np.float64), self.pitch_um)
        rise = (columns - middle_um) * across + (rows - middle_down_um) * down
        # Skin that rises outwards is pushed together as it is seen nearer to the middle.
        return np.asarray(self.pitch_um**2 * shares * (shares - self.nearness_per_um * np.nan_to_num(rise)))

    def seen_at(self, place_um: Float64Array, z_um: float) -> Float64Array:
        """Where skin lies that is seen at (column, row) on the grid of pixels, µm."""
        middle = np.array(self.middle_um)
        return np.asarray(middle + (place_um - middle) * self.share(z_um))
