"""Whether skin that is flat on the mean is a surface: texture that fills a field, or skin that nothing touches.

Errors of slopes belong to no surface: integration keeps half of their power and removes the other half. Slopes of a
surface it keeps. So where waves of some ten cells are kept with clearly more amplitude than is removed of them, an
object shows.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, GradientField, HeightMap, MaskArray
from host_sync.integration.datum import SurfaceCells, height_of_rest_um

ACROSS: Final = 240
"""Cells along the reduced field's columns."""

FINEST_CELLS: Final = 1.0
LONGEST_CELLS: Final = 6.0
"""Standard deviations of the Gaussians between which waves are compared, and within which their power is averaged."""

STEEP: Final = 0.1
AWAY_CELLS: Final = 18
"""Slope of an object's flanks, and cells from them within which the Gaussians bring their relief along."""

HOLE_CELLS: Final = 3
"""Cells from a hole within which slopes are those of its border."""

MAX_KEPT: Final = 1.5
"""Amplitude that integration keeps of slopes over what it removes, above which they are a surface.

The lowest tenth of untouched skin shows 0.6 to 0.8 on rendered and real sensors, of texture that fills the field 2.6 to
5.6.
"""

MIN_KEPT: Final = 0.004
"""Root mean square slope below which waves of an object's foot, which fade into untouched skin, are no texture."""

QUIETEST: Final = 0.1
MIN_CELLS: Final = 100
MIN_SIDE: Final = 4
"""Cells that tell, and along the shorter side of a field that has any."""


def is_relief(height: HeightMap, gradients: GradientField, skin: MaskArray) -> bool:
    """Whether flat skin is an object's texture; False where too little of it lies far from steep flanks.

    gradients : slopes before they were integrated, arrays of shape (H, W)
    skin : bool array of shape (H, W)
    """
    cell = max(1, round(skin.shape[1] / ACROSS))
    cells = SurfaceCells.of(height, gradients, height_of_rest_um(height, skin), skin, cell)
    count = cells.count
    if min(count.shape) < MIN_SIDE:
        return False
    whole = np.maximum(cv2.GaussianBlur(count, (0, 0), FINEST_CELLS), np.float32(1e-6))
    z, p, q = (cv2.GaussianBlur(part, (0, 0), FINEST_CELLS) / whole for part in (cells.z_px, cells.p, cells.q))
    beside = _around(np.hypot(p, q) > STEEP, AWAY_CELLS) | _around(count < 1.0, HOLE_CELLS)
    inner = (cells.skin >= 0.5 * cell * cell) & ~beside
    if int(inner.sum()) < MIN_CELLS:
        return False
    by_p, by_q = (np.gradient(z, cell, axis=axis) for axis in (1, 0))
    kept, removed = _power(np.stack([by_p, by_q])), _power(np.stack([p - by_p, q - by_q]))
    ratio = np.sqrt(kept[inner] / np.maximum(removed[inner], np.float32(1e-12)))
    return bool(np.quantile(ratio, QUIETEST) > MAX_KEPT and np.quantile(kept[inner], QUIETEST) > MIN_KEPT**2)


def _around(mask: MaskArray, cells: int) -> MaskArray:
    """Cells that are no farther from a mask."""
    square = np.ones((2 * cells + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), square).astype(np.bool_))


def _power(slopes: NDArray[np.floating]) -> Float32Array:
    """Mean square nearby of slopes (2, h, w) without their long waves."""
    fine = [part - cv2.GaussianBlur(part, (0, 0), LONGEST_CELLS) for part in slopes.astype(np.float32)]
    square = np.asarray(fine[0] * fine[0] + fine[1] * fine[1], np.float32)
    return np.asarray(cv2.GaussianBlur(square, (0, 0), LONGEST_CELLS), np.float32)
