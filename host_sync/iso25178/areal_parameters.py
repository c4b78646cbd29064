"""Height parameters (Sa, Sq, Sp, Sv, Sz, Ssk, Sku) and hybrid parameters (Sdq, Sdr) of ISO 25178-2.

Heights count from the mean of the valid pixels. The standard leaves the derivative open: Sdq takes differences of
neighbouring pixels, each direction over the pairs of which both are valid, because a central difference would miss what
is two pixels wide. Sdr takes the area over each square of four valid pixels, as the mean of both triangulations.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from device.surface.fields import Float32Array, Float64Array
from host_sync.kernels.jit import njit


def height_parameters(z_um: Float32Array) -> dict[str, float]:
    """Sa, Sq, Sp, Sv, Sz in µm, Ssk, Sku without unit; all NaN without a valid pixel.

    z_um : float32 array of shape (H, W), NaN where invalid
    """
    first = _height_sums(z_um, 0.0)
    count = first[:, 0].sum()
    if not count:
        return dict.fromkeys(("Sa", "Sq", "Sp", "Sv", "Sz", "Ssk", "Sku"), float("nan"))
    mean = float(first[:, 1].sum() / count)
    sums = _height_sums(z_um, mean)
    absolute, square, cube, fourth = (float(sums[:, k].sum() / count) for k in (2, 3, 4, 5))
    sq = float(np.sqrt(square))
    peak, pit = float(sums[:, 6].max()), float(-sums[:, 7].min())
    return {
        "Sa": absolute,
        "Sq": sq,
        "Sp": peak,
        "Sv": pit,
        "Sz": peak + pit,
        "Ssk": cube / sq**3 if sq else float("nan"),
        "Sku": fourth / sq**4 if sq else float("nan"),
    }


@njit(cache=True)
def _height_sums(z_um: Any, mean: Any) -> Float64Array:
    """Count, sums of h, |h|, h², h³, h⁴, and extremes of h = z - mean, row by row: float64 array of shape (H, 8)."""
    rows, columns = z_um.shape
    sums = np.zeros((rows, 8))
    for r in range(rows):
        sums[r, 6], sums[r, 7] = -np.inf, np.inf
        for c in range(columns):
            h = np.float64(z_um[r, c]) - mean
            if np.isfinite(h):
                square = h * h
                sums[r, 0] += 1.0
                sums[r, 1] += h
                sums[r, 2] += abs(h)
                sums[r, 3] += square
                sums[r, 4] += square * h
                sums[r, 5] += square * square
                sums[r, 6] = max(sums[r, 6], h)
                sums[r, 7] = min(sums[r, 7], h)
    return sums


def hybrid_parameters(z_um: Float32Array, pitch_um: float) -> dict[str, float]:
    """Sdq (µm/µm) and Sdr (%); NaN without valid neighbours.

    z_um : float32 array of shape (H, W), NaN where invalid
    """
    sums = _slope_sums(z_um, 1.0 / pitch_um).sum(axis=0)
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
def _slope_sums(z_um: Any, per_um: Any) -> Float64Array:
    """Sum and number of squared slopes across, the same down, area and number of squares: array of shape (H, 6)."""
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
