"""The Gaussian profile filter (ISO 16610-21), of first order at ends and beside holes (ISO 16610-31)."""

from __future__ import annotations

import numpy as np
from scipy.signal import fftconvolve

from device.surface.fields import Float64Array
from host_sync.filters.gaussian_regression import ALPHA, REACH

_MIN_DETERMINANT = 1e-6


def profile_mean(z_um: Float64Array, cutoff_samples: float) -> Float64Array:
    """Gaussian mean line of the valid samples: float64 array of shape (N,), NaN where `z_um` is NaN."""
    sigma = ALPHA * cutoff_samples / np.sqrt(2.0 * np.pi)
    reach = max(int(np.ceil(REACH * sigma)), 1)
    x = np.arange(-reach, reach + 1) / sigma
    weight = np.exp(-0.5 * x * x)
    weight /= weight.sum()
    valid = np.isfinite(z_um)
    if not valid.any():
        return z_um.copy()
    level = float(z_um[valid].mean())
    filled = np.where(valid, z_um - level, 0.0)

    def around(values: Float64Array, power: int) -> Float64Array:
        # Reversed, as the sum is taken around a sample.
        return np.asarray(fftconvolve(values, (weight * x**power)[::-1], mode="full")[reach : reach + values.size])

    ones = valid.astype(np.float64)
    n, first, second = (around(ones, power) for power in range(3))
    z0, z1 = (around(filled, power) for power in range(2))
    n = np.maximum(n, 1e-9)
    determinant = n * second - first * first
    spans = determinant > _MIN_DETERMINANT * n * n
    line = (z0 * second - z1 * first) / np.where(spans, determinant, 1.0)
    return np.where(valid, np.where(spans, line, z0 / n) + level, np.nan)
