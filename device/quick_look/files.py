"""The quick look as files of a scan bundle: heights for programs, a picture for people."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np
import tifffile

from device.surface.fields import HeightMap, surface_slopes

HEIGHT_FILE: Final = "quick-look-um.tif"
PICTURE_FILE: Final = "quick-look.png"
_LIGHT: Final = (-0.55, -0.55, 0.63)


def write_quick_look(directory: Path, height: HeightMap) -> None:
    """Write the heights (float32 TIFF, µm) and the shaded picture (PNG, 8 bit) into a directory."""
    tifffile.imwrite(
        directory / HEIGHT_FILE, height.z_um, description=f"height, um; pixel pitch {height.pitch_um:g} um"
    )
    encoded = cv2.imencode(".png", shaded_picture(height))[1]
    (directory / PICTURE_FILE).write_bytes(encoded.tobytes())


def shaded_picture(height: HeightMap) -> np.ndarray:
    """Diffuse shading from the upper left: uint8 array of shape (H, W)."""
    p, q = surface_slopes(height)
    cosine = (-p * _LIGHT[0] - q * _LIGHT[1] + _LIGHT[2]) / np.sqrt(1.0 + p * p + q * q)
    return np.asarray(np.clip(255.0 * (0.15 + 0.85 * cosine), 0.0, 255.0), np.uint8)
