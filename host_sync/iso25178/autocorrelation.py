"""Spatial parameters of ISO 25178-2: Sal, Str from the autocorrelation, Std from the angular spectrum.

The autocorrelation at a shift is the mean product of the pairs of valid pixels at that distance, divided by the mean
square. Each shift has its own number of pairs, so that borders and holes do not bias it. Shifts with few pairs, beyond
about half of the field, are not evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates

from device.surface.fields import Float32Array, Float64Array, MaskArray

FALLEN_TO: Final = 0.2
"""Threshold of the correlation, the default of the standard."""

STEP_DEG: Final = 1.0
STEP_PX: Final = 0.5
STD_STEP_DEG: Final = 0.5
MIN_PAIRS: Final = 0.1
"""Fewest pairs of an evaluated shift, as a fraction of the valid pixels."""


@dataclass(frozen=True, slots=True)
class Decay:
    """Decay of the autocorrelation to the threshold.

    shortest_px, longest_px : smallest and largest decay length over all directions, pixels; NaN when unknown
    reached : whether it decays in every direction within the field; else `longest_px` is a lower limit
    """

    shortest_px: float
    longest_px: float
    reached: bool


class Autocorrelation:
    """The autocorrelation on one mask; its pairs are counted once.

    Parameters
    ----------
    valid : bool array of shape (H, W)
    """

    def __init__(self, valid: MaskArray) -> None:
        self._valid = valid
        self._lags = [max(side // 2, 1) for side in valid.shape]
        pairs = zip(valid.shape, self._lags, strict=True)
        self._size = [scipy.fft.next_fast_len(side + lag, real=True) for side, lag in pairs]
        self._pairs = np.maximum(np.rint(self._products(valid.astype(np.float32))), np.float32(0.0))

    def of(self, z_um: Float32Array) -> Float32Array:
        """Autocorrelation, float32 array of shape (2 h + 1, w + 1), shift (0, 0) at (h, 0); NaN with too few pairs."""
        count = float(self._valid.sum())
        level = np.float32(z_um[self._valid].mean(dtype=np.float64)) if count else np.float32(0.0)
        products = self._products(np.where(self._valid, z_um - level, np.float32(0.0)))
        enough = self._pairs > MIN_PAIRS * count
        mean = np.where(enough, products / np.maximum(self._pairs, np.float32(1.0)), np.float32(np.nan))
        square = mean[self._lags[0], 0]
        return np.asarray(mean / square if square > 0.0 else np.full_like(mean, np.nan), np.float32)

    def _products(self, values: Float32Array) -> Float32Array:
        """Sums of products at each shift, negative rows first: float32 array of shape (2 h + 1, w + 1)."""
        spectrum = scipy.fft.rfft2(values, self._size)
        power = spectrum.real**2 + spectrum.imag**2
        sums = np.asarray(scipy.fft.irfft2(power, self._size), np.float32)[:, : self._lags[1] + 1]
        return np.concatenate([sums[-self._lags[0] :], sums[: self._lags[0] + 1]])


def decay(correlation: Float32Array, fallen_to: float = FALLEN_TO) -> Decay:
    """Decay of an autocorrelation, as `Autocorrelation.of` returns it, around shift (0, 0)."""
    middle = correlation.shape[0] // 2
    if not np.isfinite(correlation[middle, 0]):
        return Decay(float("nan"), float("nan"), reached=False)
    # The other half of the shifts is its mirror image.
    angle = np.radians(np.arange(-90.0, 90.0, STEP_DEG))
    reach = float(np.hypot(middle, correlation.shape[1] - 1))
    radius = np.arange(0.0, reach + STEP_PX, STEP_PX)
    fallen = np.array([_first_below(correlation, middle, one, radius, fallen_to) for one in angle])
    lengths, seen = fallen[:, 0], fallen[:, 1] > 0.0
    shortest = float(lengths[seen].min()) if seen.any() else float("nan")
    return Decay(shortest, float(lengths.max()), bool(seen.all()))


def _first_below(
    correlation: Float32Array, middle: int, angle: float, radius: Float64Array, fallen_to: float
) -> tuple[float, float]:
    """Decay length of a direction (pixels) and 1.0; or the longest evaluated shift and 0.0."""
    row, column = middle + radius * np.sin(angle), radius * np.cos(angle)
    inside = (row >= 0.0) & (row <= correlation.shape[0] - 1) & (column <= correlation.shape[1] - 1)
    row, column = row[inside], column[inside]
    values = map_coordinates(correlation, [row, column], order=1, mode="nearest")
    below = np.flatnonzero(~(values >= fallen_to))
    if not below.size or not np.isfinite(values[below[0]]):
        return float(radius[(below[0] if below.size else values.size) - 1]), 0.0
    last = int(below[0])
    before, after = float(values[last - 1]), float(values[last])
    return STEP_PX * (last - 1 + (before - fallen_to) / (before - after)), 1.0


def texture_direction_deg(correlation: Float32Array) -> float:
    """Std: angle of the maximum of the angular power spectrum, counter-clockwise from the column axis, -90° to 90°.

    It is the direction across the lay. The power spectrum is the Fourier transform of the tapered autocorrelation.
    """
    middle, width = correlation.shape[0] // 2, correlation.shape[1] - 1
    reach = min(middle, width)
    if reach < 4:
        return float("nan")
    half = np.nan_to_num(correlation[middle - reach : middle + reach + 1, : reach + 1])
    whole = np.concatenate([half[::-1, :0:-1], half], axis=1)
    lag = np.arange(-reach, reach + 1, dtype=np.float32) / np.float32(reach + 1.0)
    taper = np.maximum(np.float32(1.0) - np.hypot(lag[:, None], lag), np.float32(0.0))
    # Magnitudes only, so the position of shift (0, 0) in the array does not matter.
    power = np.abs(scipy.fft.fftshift(scipy.fft.rfft2(whole * taper), axes=0))
    angle = np.radians(np.arange(-90.0, 90.0, STD_STEP_DEG))
    radius = np.arange(1.5, reach, 0.5)
    row = reach - radius * np.sin(angle)[:, None]
    column = radius * np.cos(angle)[:, None]
    along = map_coordinates(power, [row, column], order=1).sum(axis=1)
    return float(np.degrees(angle[int(along.argmax())]))
