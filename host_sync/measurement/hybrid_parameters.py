"""Hybrid parameters of ISO 25178-2: Sdq and Sdr.

The standard leaves the derivative open. Sdq takes the difference of neighbouring pixels, each direction over its own
pairs, as both ends of a pair must be valid; a central difference would pass over what is two pixels wide. Sdr takes the
area over each square of four valid pixels, the mean of both ways of cutting it into two triangles.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from device.surface import Float32Array, Float64Array


def hybrid_parameters(z_um: Float32Array, pitch_um: float) -> dict[str, float]:
    """Sdq (µm/µm) and Sdr (%); NaN where no neighbours are valid.

    z_um : float32 array of shape (H, W), NaN where invalid
    """
    sums = _sums(z_um, 1.0 / pitch_um).sum(axis=0)
    if not (sums[1] and sums[3] and sums[5]):
        return {"Sdq": float("nan"), "Sdr": float("nan")}
    return {
        "Sdq": float(np.sqrt(sums[0] / sums[1] + sums[2] / sums[3])),
        "Sdr": 100.0 * float(sums[4] / sums[5] - 1.0),
    }


@njit(cache=True, inline="always")
def _two_triangles(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Area over a unit square with heights a b / c d, cut along b-c."""
    upper = 0.5 * np.sqrt(1.0 + (b - a) ** 2 + (c - a) ** 2)
    return upper + 0.5 * np.sqrt(1.0 + (d - c) ** 2 + (d - b) ** 2)


@njit(cache=True)
def _sums(z_um: Any, per_um: Any) -> Float64Array:
    """Squared slopes across and their number, down likewise, area and number of squares: array of shape (H, 6)."""
    rows, columns = z_um.shape
    sums = np.zeros((rows, 6))
    for r in range(rows):
        below = min(r + 1, rows - 1)
        for k in range(columns):
            after = min(k + 1, columns - 1)
            a, b = z_um[r, k] * per_um, z_um[r, after] * per_um
            c, d = z_um[below, k] * per_um, z_um[below, after] * per_um
            if after > k and np.isfinite(b - a):
                sums[r, 0] += (b - a) ** 2
                sums[r, 1] += 1.0
            if below > r and np.isfinite(c - a):
                sums[r, 2] += (c - a) ** 2
                sums[r, 3] += 1.0
            if after > k and below > r and np.isfinite(a + b + c + d):
                sums[r, 4] += 0.5 * (_two_triangles(a, b, c, d) + _two_triangles(b, a, d, c))
                sums[r, 5] += 1.0
    return sums
