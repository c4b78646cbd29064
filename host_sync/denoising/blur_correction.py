"""What the camera's blur takes from a surface, given back as far as every camera takes it.

A blur of standard deviation s takes ½ s² ∇²z from heights, to first order: of a wave of 20 px 1.2 % with s = 0.5 px, of
one of 10 px 5 %. A pixel's own square has 0.29 px; a lens that suits its pixels makes 0.5 px of it, and more is not
known: what may be lost beyond that is in the uncertainty (`resolution_uncertainty`). Only the surface with shrunk
detail is corrected: raw detail's noise would grow.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface.fields import HeightMap

BLUR_PX: Final = 0.5
"""Standard deviation of the blur that is taken out."""

_KERNEL: Final = np.zeros((5, 5), np.float32)
"""½ s² times a Laplacian over pixels that are two apart, which sees little of the noise from pixel to pixel."""
_KERNEL[2, ::2] += np.float32(0.125 * BLUR_PX**2) * np.array([1.0, -2.0, 1.0], np.float32)
_KERNEL[::2, 2] += np.float32(0.125 * BLUR_PX**2) * np.array([1.0, -2.0, 1.0], np.float32)


def without_blur(height: HeightMap) -> HeightMap:
    """The height map less the Laplacian that a blur added; unchanged next to invalid pixels."""
    added = cv2.filter2D(height.z_um, cv2.CV_32F, _KERNEL, borderType=cv2.BORDER_REPLICATE)
    np.nan_to_num(added, copy=False, nan=0.0)
    return HeightMap(height.z_um - added, height.pitch_um)
