"""How sharp a frame is: its fine contrast over its coarser contrast, where it shows any.

Only edges can be sharp: a frame of gentle slopes has no focus to be measured, and gets None.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.photometry import IntensityImage

SCALES_PX: Final = (1.4, 2.8, 5.6)
"""Standard deviations of the Gaussians between which contrast counts as fine and as coarser."""

EDGES_PERCENTILE: Final = 99.5
LEAST_CONTRAST: Final = 0.03


def sharpness(intensity: IntensityImage) -> float | None:
    """Fine over coarser contrast of the strongest edges; None when there are none."""
    green = np.ascontiguousarray(intensity.values[..., 1])
    fine, middle, coarse = (cv2.GaussianBlur(green, (0, 0), scale) for scale in SCALES_PX)
    coarser = float(np.percentile(np.abs(middle - coarse)[::2, ::2], EDGES_PERCENTILE))
    if coarser < LEAST_CONTRAST:
        return None
    return float(np.percentile(np.abs(fine - middle)[::2, ::2], EDGES_PERCENTILE)) / coarser
