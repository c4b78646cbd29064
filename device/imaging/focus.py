"""Focus figure: fine contrast of whatever the camera sees, for turning a lens to its sharpest place.

Unlike a scan's sharpness it needs neither a reference nor an edge, and compares frames of one scene only.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import bin_bayer
from hal.frame import RawFrame

SCALES_PX: Final = (0.7, 1.4)
"""Standard deviations of the Gaussians whose difference is fine contrast, in pairs of pixels."""

CENTRE: Final = 0.5
"""Part of the field's width and height that is judged: a lens is focused at the centre."""


def focus_figure(frame: RawFrame) -> float:
    """Standard deviation of the fine contrast at the field's centre, per thousand of the mean light; 0 in darkness."""
    light = bin_bayer(frame).rgb
    rows, columns = light.shape[:2]
    down, right = (round(size * (1.0 - CENTRE) / 2.0) for size in (rows, columns))
    green = np.ascontiguousarray(light[down : rows - down, right : columns - right, 1])
    mean = float(green.mean())
    if mean <= 0.0:
        return 0.0
    fine, coarse = (cv2.GaussianBlur(green, (0, 0), scale) for scale in SCALES_PX)
    return 1e3 * float((fine - coarse).std()) / mean
