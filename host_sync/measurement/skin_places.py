"""Places on the skin of the pixels of a height map.

A camera that is not far away sees raised skin larger: what stands z over the untouched skin lies nearer to the middle
of the field than its pixel does there, by the share z / h, where h is the height of the camera's pupil
(`device/balls/viewpoint.py`).
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
    level : what levelling took off the heights: µm at the middle, and per µm right and down of it
    """

    pitch_um: float
    middle_um: tuple[float, float] = (0.0, 0.0)
    nearness_per_um: float = 0.0
    level: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, record: ResultRecord) -> SkinPlaces:
        """Those of a result."""
        pitch_um = record.pixel_pitch_um
        middle_um = 0.5 * pitch_um * (record.columns - 1), 0.5 * pitch_um * (record.rows - 1)
        return cls(pitch_um, middle_um, 0.0 if record.pupil_height_mm is None else 1e-3 / record.pupil_height_mm)

    def levelled(self, zero_um: float, down: float, across: float) -> SkinPlaces:
        """Return the same where heights have lost a plane: µm at the middle of the field, and per pixel down and
        across.
        """
        return replace(self, level=(zero_um, across / self.pitch_um, down / self.pitch_um))

    def of_part(self, rows: slice, columns: slice) -> SkinPlaces:
        """Those of a part of the field, from the part's first pixel."""
        across_um, down_um = self.middle_um
        left_um, top_um = columns.start * self.pitch_um, rows.start * self.pitch_um
        return replace(self, middle_um=(across_um - left_um, down_um - top_um))

    def at(self, z_um: Float32Array) -> tuple[Float64Array, Float64Array]:
        """Right and down of the first pixel, of each pixel of a height map: float64 arrays of shape (H, W), µm."""
        x, y = self._from_middle(z_um.shape)
        shares = self._shares(x, y, z_um)
        return self.middle_um[0] + x * shares, self.middle_um[1] + y * shares

    def areas_um2(self, z_um: Float32Array) -> Float64Array:
        """Area of the skin in each pixel, as seen from above, float64 array of shape (H, W), µm²."""
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
        """Right of the camera, shape (W,), and below it, shape (H, 1), µm."""
        rows, columns = (np.arange(side, dtype=np.float64) * self.pitch_um for side in shape)
        return np.asarray(columns - self.middle_um[0]), np.asarray(rows - self.middle_um[1])[:, None]

    def _shares(self, x: Float64Array, y: Float64Array, z_um: Float32Array | Float64Array | float) -> Float64Array:
        """Lengths on skin of these heights over what they would be untouched."""
        zero_um, across, down = self.level
        over_skin_um = np.asarray(z_um, np.float64) + (zero_um + across * x + down * y)
        return np.maximum(1.0 - self.nearness_per_um * over_skin_um, MIN_SHARE)
