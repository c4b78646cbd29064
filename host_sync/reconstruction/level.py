"""Where a height map has its zero: skin that nothing touches.

It is flat over a patch, not only at a pixel, and reaches the frame's border; the plateau of an object is flat too, and
the skin that sinks towards rest around it is nearly so.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from scipy import ndimage

from device.surface import GradientField, HeightMap, MaskArray

FLAT_SLOPES: Final = (0.01, 0.05)
"""Slopes under which a patch of skin counts as flat; the second is tried when the first finds too little."""

PATCH_SHARE: Final = 1.0 / 64.0
"""Size of a patch as a share of the frame's columns."""

LEAST_SHARE: Final = 0.02
"""Share of the valid pixels that untouched skin must make up."""


def untouched_skin(gradients: GradientField) -> MaskArray:
    """True where the skin is at rest: bool array of shape (H, W); every valid pixel when no such place is found."""
    valid = gradients.valid
    patch = max(3, round(PATCH_SHARE * valid.shape[1]) | 1)
    share = np.maximum(cv2.blur(valid.astype(np.float32), (patch, patch)), np.float32(1e-3))
    mean = [
        cv2.blur(np.where(valid, slope, np.float32(0.0)), (patch, patch)) / share
        for slope in (gradients.p, gradients.q)
    ]
    steepness = np.hypot(*mean)
    for limit in FLAT_SLOPES:
        flat = _reaching_the_border(valid & (steepness < limit))
        if flat.sum() >= LEAST_SHARE * valid.sum():
            return flat
    return valid


def levelled(height: HeightMap, at_rest: MaskArray) -> HeightMap:
    """The height map with zero at the median of the skin at rest."""
    heights = height.z_um[at_rest & np.isfinite(height.z_um)]
    zero = np.median(heights) if heights.size else np.float32(0.0)
    return HeightMap(height.z_um - zero, height.pitch_um)


def _reaching_the_border(mask: MaskArray) -> MaskArray:
    """The connected parts of a mask that touch the frame's border."""
    labels, _ = ndimage.label(mask)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    return np.asarray(np.isin(labels, np.unique(border[border > 0])))
