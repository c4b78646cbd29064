"""What the camera's blur takes from a surface, given back as far as every camera takes it.

A blur of standard deviation s takes ½ s² ∇²z from heights, to first order: of a wave of 20 px 1.2 % with s = 0.5 px, of
one of 10 px 5 %. A pixel's own square has 0.29 px; a lens that suits its pixels makes 0.5 px of it, and more is not
known: what may be lost beyond that is in the uncertainty (`resolution_uncertainty`). Only the surface with shrunk
detail is corrected, and only of quiet sensors: noise grows by an eighth.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface.fields import HeightMap

BLUR_PX: Final = 0.5
"""Standard deviation of the blur that is taken out."""

MAX_NOISE_DEG: Final = 0.2
"""Noise of the surface's slopes up to which it is.

A real sensor with 0.38° loses 0.03° of accuracy by it, one with 0.1° nothing.
"""

_SECOND_DIFFERENCE: Final = np.array([1.0, -2.0, 1.0], np.float32)


def without_blur(height: HeightMap, blur_px: float) -> HeightMap:
    """The height map less the Laplacian that a blur added; unchanged next to invalid pixels.

    blur_px : standard deviation of the blur; 0 takes nothing out
    """
    if blur_px == 0.0:
        return height
    # Pixels that are two apart see little of the noise from pixel to pixel.
    kernel = np.zeros((5, 5), np.float32)
    kernel[2, ::2] = _SECOND_DIFFERENCE
    kernel[::2, 2] += _SECOND_DIFFERENCE
    kernel *= np.float32(0.125 * blur_px**2)
    added = cv2.filter2D(height.z_um, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE)
    np.nan_to_num(added, copy=False, nan=0.0)
    return HeightMap(height.z_um - added, height.pitch_um)
