"""Which lights do not reach the skin: rays over a height map, and channels that are not as bright as predicted."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, Float64Array

SET: Final = (0.16, 0.08)
"""Predicted intensity below which a light is about to set, and at which it has."""

ARRIVES: Final = (0.03, 0.12)
"""What a light alone shows, over what it shows of untouched skin: up to the first it does not arrive, from the second
it does."""


def clearance(z_px: Float32Array, cell: float, slant: Float64Array) -> Float32Array:
    """By how much the ray to a light clears the skin, as a tangent: least over the way, float32 array (h, w).

    z_px : elevation at cells `cell` pixels apart
    slant : of the light, (h, w, 2): away from it, as long as its zenith angle's tangent
    """
    rows, columns = z_px.shape
    length = np.maximum(np.linalg.norm(slant, axis=-1), 1e-3)
    rise = (1.0 / length).astype(np.float32)
    across, down = ((-slant[..., k] / length).astype(np.float32) for k in (0, 1))
    column, row = np.meshgrid(np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32))
    clear = np.full_like(z_px, np.inf)
    height_px = float(z_px.max()) - float(np.quantile(z_px, 0.01))
    reach = min(int(height_px / float(rise.min()) / cell) + 2, max(rows, columns))
    for step in range(1, reach):
        met = cv2.remap(
            z_px, column + step * across, row + step * down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        np.minimum(clear, rise - (met - z_px) / np.float32(step * cell), out=clear)
    return clear


def trust_in(intensity: Float64Array, predicted: Float64Array, darker: tuple[float, float]) -> Float64Array:
    """Weight (N, 3) of lights that may be hidden: less than 1 where darker than predicted, or about to set.

    intensity, predicted : float64 arrays of shape (N, 3), untouched skin reads 1
    darker : intensity missing of the prediction: up to the first a light counts in full, from the second not at all
    """
    missing = np.clip((predicted - intensity - darker[0]) / (darker[1] - darker[0]), 0.0, 1.0)
    setting = np.clip((SET[0] - predicted) / (SET[0] - SET[1]), 0.0, 1.0)
    return np.asarray(((1.0 - missing) * (1.0 - setting)) ** 2)


def arriving_share(alone: Float64Array) -> Float64Array:
    """Weight of lights of which so much is seen alone."""
    return np.asarray(np.clip((alone - ARRIVES[0]) / (ARRIVES[1] - ARRIVES[0]), 0.0, 1.0) ** 2)
