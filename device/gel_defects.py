"""Scratches, dust and stains of a gel: places of the resting skin that differ from their surroundings."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.health_limits import DEFECT_CONTRAST
from device.photometry import LinearFrame
from device.surface import Float32Array, MaskArray

NOISE_BLUR_PX: Final = 1.0
SURROUNDINGS_PX: Final = 8.0
"""Standard deviations, in pixels of the quick look, of what is taken for a place and for its surroundings."""


def gel_defects(rest: LinearFrame) -> MaskArray:
    """Where a frame of the resting skin shows a defect: bool array of shape (H, W)."""
    margin = round(3.0 * SURROUNDINGS_PX)
    # Odd reflection carries a slope of the light on beyond the border, where plain reflection would bend it.
    padded = np.pad(rest.rgb, ((margin, margin), (margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    place = cv2.GaussianBlur(padded, (0, 0), NOISE_BLUR_PX)
    around = cv2.GaussianBlur(padded, (0, 0), SURROUNDINGS_PX)
    contrast: Float32Array = np.abs(place / np.maximum(around, np.float32(1e-3)) - np.float32(1.0))
    inside = contrast[margin:-margin, margin:-margin].max(axis=-1)
    return np.asarray(inside > DEFECT_CONTRAST, np.bool_)
