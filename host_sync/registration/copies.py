"""Copies of one press, which are no repeated measurements: no two presses have the same noise."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.surface.fields import Float32Array

ROUNDING: Final = 1e-5
"""Difference of copies, as a fraction of the span of heights: rounding and the order of threads."""

SAMPLED_PX: Final = 128
"""Rows and columns that are compared, at most about twice as many."""


def are_copies(first_um: Float32Array, second_um: Float32Array) -> bool:
    """Return whether two height maps, float32 arrays of shape (H, W), come from the same frame.

    They do if nearly all heights agree pixel by pixel, apart from rounding.
    """
    if first_um.shape != second_um.shape:
        return False
    step = max(1, max(first_um.shape) // SAMPLED_PX)
    first_um, second_um = first_um[::step, ::step], second_um[::step, ::step]
    off = np.abs(first_um - second_um)
    known = np.isfinite(off)
    if not known.any():
        return False
    span_um = float(np.ptp(first_um[known]))
    return float(np.quantile(off[known], 0.99)) <= ROUNDING * span_um
