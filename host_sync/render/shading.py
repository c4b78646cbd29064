"""Diffuse shading of a height map under one directional light (paper, section 6)."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, HeightMap
from host_sync.kernels.jit import njit

LIGHT_AZIMUTH_DEG: Final = 135.0
LIGHT_ELEVATION_DEG: Final = 40.0
AMBIENT: Final = 0.15

PLEASANT_SLOPE: Final = 0.35
"""Slope with good contrast; flatter reliefs are exaggerated up to it."""

MAX_EXAGGERATION: Final = 20.0
STEEP_PERCENTILE: Final = 97.0


def shade(
    height: HeightMap,
    azimuth_deg: float = LIGHT_AZIMUTH_DEG,
    elevation_deg: float = LIGHT_ELEVATION_DEG,
    exaggeration: float = 1.0,
) -> Float32Array:
    """Brightness of a white diffuse surface: float32 array of shape (H, W), 0 to 1, NaN beside invalid pixels.

    azimuth_deg : azimuth of the light, counter-clockwise from the right edge of the picture; 135 is the upper left
    elevation_deg : elevation of the light above the plane
    exaggeration : factor on the slopes
    """
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    # Rows grow downwards, so that a light at the top of the picture has a negative row component.
    light = np.array([np.cos(azimuth), -np.sin(azimuth), np.tan(elevation)]) * np.cos(elevation)
    brightness = np.empty(height.z_um.shape, np.float32)
    per_pixel = np.float32(exaggeration / height.pitch_um)
    _shade(np.ascontiguousarray(height.z_um), per_pixel, light.astype(np.float32), brightness)
    return brightness


def flat_brightness(elevation_deg: float = LIGHT_ELEVATION_DEG) -> float:
    """Brightness of a flat surface."""
    return float(AMBIENT + (1.0 - AMBIENT) * np.sin(np.radians(elevation_deg)))


def steep_slope(height: HeightMap, samples: int = 250) -> float:
    """97th percentile of the slope, from about `samples` columns; 0 when no pixel is valid."""
    step = max(1, height.z_um.shape[1] // samples)
    here = height.z_um[:-1:step, :-1:step]
    across, down = height.z_um[:-1:step, 1::step], height.z_um[1::step, :-1:step]
    steepness = np.hypot(across - here, down - here) / height.pitch_um
    finite = steepness[np.isfinite(steepness)]
    return float(np.percentile(finite, STEEP_PERCENTILE)) if finite.size else 0.0


def exaggeration_for(steep: float) -> float:
    """Factor on slopes for good contrast: an integer, 1 for slopes as steep as a ball's."""
    return float(np.clip(np.round(PLEASANT_SLOPE / max(steep, 1e-6)), 1.0, MAX_EXAGGERATION))


def reduced(height: HeightMap, widest_px: int) -> HeightMap:
    """The height map averaged down to at most `widest_px` columns; a pixel with an invalid part becomes invalid."""
    columns = height.z_um.shape[1]
    factor = int(np.ceil(columns / widest_px))
    if factor <= 1:
        return height
    rows, columns = (size // factor * factor for size in height.z_um.shape)
    size = (columns // factor, rows // factor)
    small = cv2.resize(height.z_um[:rows, :columns], size, interpolation=cv2.INTER_AREA)
    return HeightMap(np.asarray(small, np.float32), height.pitch_um * factor)


@njit(cache=True, nogil=True, error_model="numpy")
def _shade(z_um: Any, per_pixel: Any, light: Any, brightness: Any) -> None:
    """Write the brightness; slopes are central differences, one-sided at the borders."""
    rows, columns = z_um.shape
    ambient, one, zero = np.float32(AMBIENT), np.float32(1.0), np.float32(0.0)
    for r in range(rows):
        above, below = max(r - 1, 0), min(r + 1, rows - 1)
        down = per_pixel / np.float32(max(below - above, 1))
        for c in range(columns):
            before, after = max(c - 1, 0), min(c + 1, columns - 1)
            p = (z_um[r, after] - z_um[r, before]) * per_pixel / np.float32(max(after - before, 1))
            q = (z_um[below, c] - z_um[above, c]) * down
            cosine = (light[2] - p * light[0] - q * light[1]) / np.sqrt(one + p * p + q * q)
            brightness[r, c] = ambient + (one - ambient) * max(zero, cosine)
