"""Diffuse shading of a height map under one directional light (paper, section 6)."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface import Float32Array, HeightMap, surface_slopes

LIGHT_AZIMUTH_DEG: Final = 135.0
LIGHT_ELEVATION_DEG: Final = 40.0
AMBIENT: Final = 0.15


def shade(
    height: HeightMap, azimuth_deg: float = LIGHT_AZIMUTH_DEG, elevation_deg: float = LIGHT_ELEVATION_DEG
) -> Float32Array:
    """Brightness of a white diffuse surface: float32 array of shape (H, W), 0 to 1, NaN where invalid.

    azimuth_deg : where the light stands, counter-clockwise from the right edge of the picture; 135 is the upper left
    elevation_deg : of the light above the plane
    """
    p, q = surface_slopes(height)
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    # Rows grow downwards, so that a light at the top of the picture has a negative row component.
    light = np.array([np.cos(azimuth), -np.sin(azimuth), np.tan(elevation)]) * np.cos(elevation)
    cosine = (-p * light[0] - q * light[1] + light[2]) / np.sqrt(1.0 + p * p + q * q)
    return np.asarray(AMBIENT + (1.0 - AMBIENT) * np.maximum(cosine, 0.0), np.float32)


def reduced(height: HeightMap, widest_px: int) -> HeightMap:
    """The height map averaged down to at most `widest_px` columns; pixels with an invalid part become invalid."""
    columns = height.z_um.shape[1]
    factor = int(np.ceil(columns / widest_px))
    if factor <= 1:
        return height
    rows, columns = (size // factor * factor for size in height.z_um.shape)
    size = (columns // factor, rows // factor)
    small = cv2.resize(height.z_um[:rows, :columns], size, interpolation=cv2.INTER_AREA)
    return HeightMap(np.asarray(small, np.float32), height.pitch_um * factor)
