"""Ambient occlusion and cast shadows of a relief; optional, the paper's figures have neither."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.surface.fields import Float32Array, HeightMap
from host_sync.kernels.jit import njit

DIRECTIONS: Final = 16
REACH_SHARE: Final = 0.15
"""Reach of ambient occlusion, as a fraction of the height map's diagonal."""

SHADOW_SOFTNESS: Final = 0.06
"""Width of the penumbra, as a tangent of the elevation."""


def ambient_occlusion(height: HeightMap, exaggeration: float) -> Float32Array:
    """Fraction of a diffuse sky that each pixel sees: float32 array of shape (H, W), NaN where invalid."""
    total = np.zeros(height.z_um.shape, np.float32)
    for turn in np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS):
        tangent = _horizon(height, exaggeration, float(turn), REACH_SHARE)
        total += 1.0 / (1.0 + np.maximum(tangent, np.float32(0.0)) ** 2)
    return np.where(np.isfinite(height.z_um), total / np.float32(DIRECTIONS), np.float32(np.nan))


def shadow_mask(height: HeightMap, exaggeration: float, azimuth_deg: float, elevation_deg: float) -> Float32Array:
    """Fraction of the light that reaches each pixel: float32 array of shape (H, W), 0 to 1."""
    tangent = _horizon(height, exaggeration, float(np.radians(azimuth_deg)), 1.0)
    free = (np.float32(np.tan(np.radians(elevation_deg))) - tangent) / np.float32(SHADOW_SOFTNESS)
    return np.asarray(np.clip(free + 0.5, 0.0, 1.0), np.float32)


def _horizon(height: HeightMap, exaggeration: float, turn: float, reach_share: float) -> Float32Array:
    """Tangent of the horizon's elevation in a direction, counter-clockwise from the right."""
    rows, columns = height.z_um.shape
    z = np.ascontiguousarray(height.z_um) * np.float32(exaggeration / height.pitch_um)
    steps = [1.0]
    # Steps grow with the distance.
    while steps[-1] < reach_share * np.hypot(rows, columns):
        steps.append(steps[-1] + max(1.0, 0.06 * steps[-1]))
    # Rounded, so that a ray along the rows stays on its row.
    down, right = (np.round(np.multiply(steps, part), 4).astype(np.float32) for part in (-np.sin(turn), np.cos(turn)))
    tangent = np.empty_like(z)
    _trace(z, down, right, np.array(steps, np.float32), tangent)
    return tangent


@njit(cache=True, nogil=True, error_model="numpy")
def _trace(z: Any, down: Any, right: Any, steps: Any, tangent: Any) -> None:
    """Write the largest tangent along a ray; beyond the border nothing hides the sky.

    Heights are interpolated: with the nearest pixel, a slope along a diagonal would be 1.4 times too steep.
    """
    rows, columns = z.shape
    for r in range(rows):
        for c in range(columns):
            steepest = np.float32(-1e6)
            for i in range(steps.size):
                y, x = np.float32(r) + down[i], np.float32(c) + right[i]
                if y < 0 or x < 0 or y > rows - 1 or x > columns - 1:
                    break
                top, left = int(y), int(x)
                low, far = min(top + 1, rows - 1), min(left + 1, columns - 1)
                v, u = y - np.float32(top), x - np.float32(left)
                above = z[top, left] + u * (z[top, far] - z[top, left])
                below = z[low, left] + u * (z[low, far] - z[low, left])
                rise = (above + v * (below - above) - z[r, c]) / steps[i]
                if rise > steepest:
                    steepest = rise
            tangent[r, c] = steepest
