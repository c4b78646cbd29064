"""Figures of a whole frame of a press: its sharpness, and the fraction of the field in contact.

Sharpness is the ratio of fine to coarser contrast at the strongest edges. Only edges can be sharp: a frame with gentle
slopes alone has no measurable focus and gets None.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage

SCALES_PX: Final = (1.4, 2.8, 5.6)
"""Standard deviations of the Gaussians whose differences are fine and coarser contrast."""

EDGES_PERCENTILE: Final = 99.5
MIN_CONTRAST: Final = 0.03


def sharpness(intensity: NormalizedImage) -> float | None:
    """Ratio of fine to coarser contrast at the strongest edges; None without edges."""
    green = np.ascontiguousarray(intensity.values[..., 1])
    fine, middle, coarse = (cv2.GaussianBlur(green, (0, 0), scale) for scale in SCALES_PX)
    coarser = float(np.percentile(np.abs(middle - coarse)[::2, ::2], EDGES_PERCENTILE))
    if coarser < MIN_CONTRAST:
        return None
    return float(np.percentile(np.abs(fine - middle)[::2, ::2], EDGES_PERCENTILE)) / coarser


SHADED: Final = 0.06
"""Difference from the intensity of flat skin, in any channel, from which a pixel counts as shaded."""


def shaded_fraction(intensity: NormalizedImage) -> float:
    """Fraction of valid pixels whose intensity differs from flat skin's."""
    smooth = cv2.GaussianBlur(intensity.values, (0, 0), 2.0)
    red, green, blue = np.moveaxis(np.abs(smooth - 1.0) > SHADED, -1, 0)
    shaded = red | green | blue
    return float(shaded[intensity.valid].mean()) if intensity.valid.any() else 0.0
