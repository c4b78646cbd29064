"""What is known of the noise of slopes, as calibration reports and results hold it."""

from __future__ import annotations

import msgspec
import numpy as np

from device.surface.fields import Float32Array
from host_sync.results.detail_name import DetailName


class SlopeNoise(msgspec.Struct, frozen=True):
    """Standard deviation of either slope's noise, as an angle of the normal, from pixel to pixel.

    In slope it is (1 + p² + q²) times as large.

    tilt_deg : tilt of the surface for which the next two are given; between them they run straight
    raw_deg, shrunk_deg : of slopes as read per pixel, from raw and from shrunk frames
    raw_kept, shrunk_kept : share of it in the slopes of the height map
    raw_height_px, shrunk_height_px : fine noise of heights over that of the height map's slopes, pixels
    """

    tilt_deg: tuple[float, ...]
    raw_deg: tuple[float, ...]
    shrunk_deg: tuple[float, ...]
    raw_kept: float
    shrunk_kept: float
    raw_height_px: float
    shrunk_height_px: float

    def added_variance(self, square: Float32Array) -> Float32Array:
        """Variance of either slope that raw detail has beyond shrunk detail, in a height map with p² + q² `square`."""
        more = self.variance(square, "raw") - self.variance(square, "shrunk")
        return np.asarray(np.maximum(more, np.float32(0.0)), np.float32)

    def variance(self, square: Float32Array, detail: DetailName) -> Float32Array:
        """Variance of either slope of a height map that is pixel noise, where p² + q² is `square`."""
        angle_deg, kept = (self.raw_deg, self.raw_kept) if detail == "raw" else (self.shrunk_deg, self.shrunk_kept)
        cosine = np.cos(np.radians(self.tilt_deg))[::-1]
        growth = np.float32(1.0) + square
        at_tilt = np.interp(1.0 / np.sqrt(growth), cosine, (kept * np.radians(angle_deg)[::-1]) ** 2)
        return np.asarray(at_tilt * growth * growth, np.float32)
