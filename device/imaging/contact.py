"""Fraction of the field where the skin is not flat."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage

SHADED: Final = 0.06
"""Difference from the intensity of flat skin, in any channel, from which a pixel counts as shaded."""


def shaded_fraction(intensity: NormalizedImage) -> float:
    """Fraction of valid pixels whose intensity differs from flat skin's."""
    smooth = cv2.GaussianBlur(intensity.values, (0, 0), 2.0)
    red, green, blue = np.moveaxis(np.abs(smooth - 1.0) > SHADED, -1, 0)
    shaded = red | green | blue
    return float(shaded[intensity.valid].mean()) if intensity.valid.any() else 0.0
