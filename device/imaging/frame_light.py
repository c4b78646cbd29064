"""Gains and offsets of a frame's channels: lights drift, and light of the surroundings leaks in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from device.imaging.flat_field import DARK_FLOOR
from device.surface.fields import Float32Array, Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class FrameLight:
    """Light of a frame against that of the calibration.

    gains : float64 array of shape (3,), brightness of each channel's lights over the calibration's
    offsets : float64 array of shape (3,), light that does not come from them, fraction of full scale
    """

    gains: Float64Array
    offsets: Float64Array

    @classmethod
    def unchanged(cls) -> FrameLight:
        """Return the light of the calibration."""
        return cls(np.ones(3), np.zeros(3))

    @property
    def change(self) -> float:
        """Largest change of a gain, relative."""
        return float(np.abs(self.gains - 1.0).max())

    @property
    def stray(self) -> float:
        """Largest offset, fraction of full scale."""
        return float(np.abs(self.offsets).max())

    def take_out(self, values: Float32Array, flat_field: Float32Array, first: int = 0, last: int | None = None) -> None:
        """Write the intensity under the calibration's light over that of a frame, in rows `first` to `last` - 1.

        values, flat_field : float32 arrays of shape (H, W, 3)
        """
        rows = slice(first, last)
        dark = np.maximum(flat_field[rows], np.float32(DARK_FLOOR))
        np.divide(self.offsets.astype(np.float32), dark, out=dark)
        values[rows] -= dark
        values[rows] *= (1.0 / self.gains).astype(np.float32)
