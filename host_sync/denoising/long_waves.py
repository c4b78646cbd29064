"""Shrinkage that leaves long waves alone.

Where a surface bends gently all of its detail is weaker than the noise, at every level, and a long wave is the sum of
such detail and a smooth rest: of a wave of 80 px shrinkage takes 1 to 2 %, of gentle slopes as much. Over long waves
noise averages out, so that nothing is won by it. What was taken is given back without its fine detail.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from host_sync.denoising.shrinkage_kernel import shrink
from host_sync.denoising.wavelet_shrinkage import Shrinkage
from host_sync.kernels.planes import as_stored

GAUSSIAN_PX: Final = 6.0
"""Standard deviation of the Gaussian whose share of the loss is given back: 0.9 of a wave of 80 px, 0.02 of 14 px."""

CELL_PX: Final = 4
"""It works on means of cells of so many pixels."""


def shrink_but_long_waves(image: NormalizedImage, shrinkage: Shrinkage) -> NormalizedImage:
    """The image (H, W, 3) with the noise of its detail shrunk; validity and clipping stay."""
    shrunk = shrink(image, shrinkage)
    rows, columns = image.shape
    cells = (max(columns // CELL_PX, 1), max(rows // CELL_PX, 1))
    stored, by_plane = as_stored(image.values)
    for channel, plane in enumerate(np.moveaxis(shrunk.values, -1, 0)):
        seen = stored[channel] if by_plane else np.ascontiguousarray(stored[..., channel])
        before, after = (cv2.resize(one, cells, interpolation=cv2.INTER_AREA) for one in (seen, plane))
        lost = cv2.GaussianBlur(before - after, (0, 0), GAUSSIAN_PX / CELL_PX)
        plane += cv2.resize(lost, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return shrunk
