"""Height noise that is finer than the reduced grid of the samples.

A cell of the samples covers several pixels. Slope uncertainty beyond the slopes of the samples is noise from pixel to
pixel; integration turns it into heights that are correlated over a few pixels only. One periodic tile of such noise is
made: white slopes, integrated by least squares, minus the part that the cells represent. Each sample lays it over the
field at a random place, scaled by the missing uncertainty.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from device.surface.fields import Float32Array

TILE_PX: Final = 512
SMOOTHINGS_PX: Final = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Standard deviations of the Gaussians that make white noise as smooth as measured noise is."""

SMOOTH_CELLS: Final = 4.0
"""Standard deviation of the Gaussian that smooths the slope variance of the samples, cells."""


class FineNoise:
    """Noise at scales between a pixel and a cell of the samples.

    Parameters
    ----------
    slope_sigma : float32 array of shape (H, W), standard uncertainty of either slope, NaN where invalid
    samples_um : float32 array of shape (K, h, w)
    pitch_um : pixel pitch, µm
    height_px : measured noise of heights over noise of slopes, pixels; correlated noise has more
    """

    def __init__(
        self,
        slope_sigma: Float32Array,
        samples_um: Float32Array,
        pitch_um: float,
        height_px: float | None = None,
    ) -> None:
        rows, columns = slope_sigma.shape
        cell_px = columns / samples_um.shape[2]
        square = _slope_square(samples_um, cell_px * pitch_um)
        held = cv2.resize(square, (columns, rows), interpolation=cv2.INTER_LINEAR)
        missing = np.sqrt(np.maximum(np.nan_to_num(slope_sigma) ** 2 - held, np.float32(0.0)))
        self._scale_um = np.asarray(missing * np.float32(pitch_um), np.float32)
        self._tile = _unit_tile(round(cell_px), height_px)

    def sample_um(self, rng: np.random.Generator) -> Float32Array:
        """One sample: float32 array of shape (H, W), µm."""
        tile = np.roll(self._tile, rng.integers(0, TILE_PX, 2), (0, 1))
        if rng.integers(2):
            tile = tile.T
        rows, columns = self._scale_um.shape
        repeats = (-(-rows // TILE_PX), -(-columns // TILE_PX))
        return np.asarray(np.tile(tile, repeats)[:rows, :columns] * self._scale_um, np.float32)


def _slope_square(samples_um: Float32Array, cell_um: float) -> Float32Array:
    """Mean square of either slope over the samples: float32 array of shape (h, w)."""
    total = np.zeros(samples_um.shape[1:], np.float32)
    for sample_um in samples_um:
        q, p = np.gradient(sample_um / np.float32(cell_um))
        total += (p * p + q * q) / np.float32(2 * len(samples_um))
    return np.asarray(cv2.GaussianBlur(total, (0, 0), SMOOTH_CELLS), np.float32)


def _unit_tile(cell_px: int, height_px: float | None) -> Float32Array:
    """Periodic heights (pixels) whose central differences have standard deviation 1: float32 array (TILE, TILE).

    height_px : standard deviation that the heights come to by smoothing; as white slopes make it where it is smaller
    """
    rng = np.random.default_rng(0)
    p, q = (np.fft.rfft2(rng.standard_normal((TILE_PX, TILE_PX))) for _ in range(2))
    across = 2j * np.sin(np.pi * np.fft.rfftfreq(TILE_PX))
    down = 2j * np.sin(np.pi * np.fft.fftfreq(TILE_PX))[:, None]
    square = np.abs(across) ** 2 + np.abs(down) ** 2
    square[0, 0] = 1.0
    heights = np.fft.irfft2((np.conj(across) * p + np.conj(down) * q) / square, (TILE_PX, TILE_PX)).astype(np.float32)
    coarse = cv2.resize(heights, (TILE_PX // cell_px,) * 2, interpolation=cv2.INTER_AREA)
    fine = heights - cv2.resize(coarse, (TILE_PX, TILE_PX), interpolation=cv2.INTER_LINEAR)
    tile = _of_unit_slope(fine)
    for sigma_px in SMOOTHINGS_PX if height_px else ():
        if float(tile.std()) >= (height_px or 0.0):
            break
        tile = _of_unit_slope(np.asarray(gaussian_filter(fine, sigma_px, mode="wrap"), np.float32))
    return tile


def _of_unit_slope(heights: Float32Array) -> Float32Array:
    slopes = [np.roll(heights, -1, axis) - np.roll(heights, 1, axis) for axis in (0, 1)]
    return np.asarray(heights / (0.5 * np.sqrt(np.mean(np.square(slopes)))), np.float32)
