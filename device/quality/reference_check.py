"""Check of a reference: untouched skin's light is smooth, without spots, and shaped as the last reference's."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.imaging.flat_field import LinearFrame
from device.inverse_map.polynomial_features import monomials
from device.quality.thresholds import MAX_DEFECTS
from device.quality.untouched import block_means, gel_defects
from device.surface.fields import Float32Array

SMOOTH_DEGREE: Final = 4
"""Degree in position of a polynomial that follows the logarithm of near lights over a field, to about one percent."""

MAX_UNEVEN: Final = 0.06
"""Largest relative deviation of a block's light from that polynomial on untouched skin."""

MAX_CHANGED: Final = 0.025
"""95th percentile of the relative change of a channel's shape since the last reference, levels removed."""

_DARK: Final = 1e-3


def reference_fault(reference: LinearFrame) -> str:
    """Why a frame cannot be of clean, untouched skin; empty if it can. A smooth object over the whole field can."""
    defects = float(gel_defects(reference).mean())
    uneven = _unevenness(block_means(reference.rgb))
    if uneven > MAX_UNEVEN:
        return f"something touches the gel: its light is uneven by {uneven:.0%}"
    if defects > MAX_DEFECTS:
        return f"{defects:.0%} of the skin is touched, scratched or dirty: lift off, wipe the gel"
    return ""


def changed_shape(reference: LinearFrame, last: LinearFrame) -> float:
    """Return how much the light's shape over the field differs from the last reference's, relative, lights' levels
    removed.
    """
    ratio = block_means(reference.rgb) / np.maximum(block_means(last.rgb), np.float32(_DARK))
    ratio /= np.median(ratio, axis=(0, 1))
    return float(np.percentile(np.abs(ratio - 1.0), 95))


def _unevenness(light: Float32Array) -> float:
    """Largest deviation of the logarithm of blocks' light, (rows, columns, 3), from a smooth polynomial."""
    rows, columns, _ = light.shape
    across, down = np.meshgrid(np.linspace(-1.0, 1.0, columns), np.linspace(-1.0, 1.0, rows))
    design = monomials(np.stack([across.ravel(), down.ravel()], axis=-1), SMOOTH_DEGREE)
    target = np.log(np.maximum(light.reshape(-1, 3).astype(np.float64), _DARK))
    coefficients, *_ = np.linalg.lstsq(design, target, rcond=None)
    return float(np.abs(target - design @ coefficients).max())
