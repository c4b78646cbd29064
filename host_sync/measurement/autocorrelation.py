"""Spatial parameters of ISO 25178-2: Sal, Str from the autocorrelation, Std from the angular spectrum.

The autocorrelation at a shift is the mean product of the pairs of valid pixels that far apart, over the mean square:
each shift has its own number of pairs, so that borders and holes take nothing away from it. Shifts that reach over more
than half of the field leave few pairs and are not looked at.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates

from device.surface import Float32Array, Float64Array, MaskArray

FALLEN_TO: Final = 0.2
"""The standard's default: correlation at which it counts as gone."""

STEP_DEG: Final = 1.0
STEP_PX: Final = 0.5
STD_STEP_DEG: Final = 0.5
LEAST_PAIRS: Final = 0.1
"""Shifts with fewer pairs than this share of the valid pixels are not looked at."""


@dataclass(frozen=True, slots=True)
class Decay:
    """How the autocorrelation falls.

    shortest_px, longest_px : least and largest shift, over directions, at which it has fallen, pixels; NaN when unknown
    reached : whether it falls in every direction within the field; else `longest_px` is as far as could be seen
    """

    shortest_px: float
    longest_px: float
    reached: bool


class Autocorrelation:
    """The autocorrelation on one mask, whose pairs are counted once.

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
        enough = self._pairs > LEAST_PAIRS * count
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
    """How an autocorrelation, as `Autocorrelation.of` returns it, falls around shift (0, 0)."""
    middle = correlation.shape[0] // 2
    if not np.isfinite(correlation[middle, 0]):
        return Decay(float("nan"), float("nan"), reached=False)
    # The other half of the shifts mirrors this one.
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
    """Shift (pixels) at which a direction has fallen, and 1.0; or how far it could be seen, and 0.0."""
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
    """Std: angle of the largest angular power spectrum, counter-clockwise from the columns' axis as seen, -90° to 90°.

    It is the direction across the lay. The power spectrum is the Fourier transform of the autocorrelation, which is
    tapered so that the border of the shifts does not ring.
    """
    middle, width = correlation.shape[0] // 2, correlation.shape[1] - 1
    reach = min(middle, width)
    if reach < 4:
        return float("nan")
    half = np.nan_to_num(correlation[middle - reach : middle + reach + 1, : reach + 1])
    whole = np.concatenate([half[::-1, :0:-1], half], axis=1)
    lag = np.arange(-reach, reach + 1, dtype=np.float32) / np.float32(reach + 1.0)
    taper = np.maximum(np.float32(1.0) - np.hypot(lag[:, None], lag), np.float32(0.0))
    # Magnitudes only: where the middle of the shifts lies in the array does not matter.
    power = np.abs(scipy.fft.fftshift(scipy.fft.rfft2(whole * taper), axes=0))
    angle = np.radians(np.arange(-90.0, 90.0, STD_STEP_DEG))
    radius = np.arange(1.5, reach, 0.5)
    row = reach - radius * np.sin(angle)[:, None]
    column = radius * np.cos(angle)[:, None]
    along = map_coordinates(power, [row, column], order=1).sum(axis=1)
    return float(np.degrees(angle[int(along.argmax())]))
