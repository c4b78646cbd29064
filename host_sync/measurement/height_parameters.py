"""Height parameters of ISO 25178-2: Sa, Sq, Sp, Sv, Sz, Ssk, Sku, over the valid pixels and from their mean."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from device.surface import Float32Array, Float64Array


def height_parameters(z_um: Float32Array) -> dict[str, float]:
    """Sa, Sq, Sp, Sv, Sz in µm, Ssk, Sku without unit; NaN of a surface without a valid pixel.

    z_um : float32 array of shape (H, W), NaN where invalid
    """
    first = _sums(z_um, 0.0)
    count = first[:, 0].sum()
    if not count:
        return dict.fromkeys(("Sa", "Sq", "Sp", "Sv", "Sz", "Ssk", "Sku"), float("nan"))
    mean = float(first[:, 1].sum() / count)
    sums = _sums(z_um, mean)
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
def _sums(z_um: Any, mean: Any) -> Float64Array:
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
