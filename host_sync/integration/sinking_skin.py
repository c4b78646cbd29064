"""How high skin still stands where it was taken for zero: beside an object it sinks towards rest for a long way.

Free skin under tension that its elastomer pulls back is bent in proportion to its height: z = L² · div(slope), with one
length L for the whole field (a membrane on springs). Where an object reaches far, all skin of a frame is still above
rest. Its heights against its bend tell the length, and the height at which skin is not bent: the true zero. The bend
is taken as the noisy one of both, so that noise moves no zero.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, Float64Array, GradientField, HeightMap, MaskArray
from host_sync.integration.datum import SurfaceCells

ACROSS: Final = 160
"""Cells along the reduced field's columns."""

SMOOTHING: Final = 2.0
"""Standard deviation, in cells, of the Gaussian that takes noise out of slopes before they are differentiated."""

LOW_SHARE: Final = 0.25
"""Skin is free, as far as it hangs together with skin at rest, up to this share of the map's height."""

MIN_CELLS: Final = 200
MIN_CORRELATION: Final = 0.8
"""Of heights and bends, below which they tell nothing."""

ROUNDS: Final = 5
OUTLIER: Final = 2.5
"""Cells off by so many standard deviations are left out of the next round's line."""

MAX_SHARE: Final = 0.05
"""Of the map's height, at most, that skin at rest is taken to stand above zero."""


def height_left_um(height: HeightMap, gradients: GradientField, resting: MaskArray, zero_um: float) -> float:
    """By how much the zero lies above skin that is at rest, µm; 0 where free skin does not tell it.

    gradients : its slopes, arrays of shape (H, W)
    resting : bool array of shape (H, W), skin from which the zero was taken
    zero_um : that zero
    """
    rows, columns = gradients.p.shape
    cell = max(1, round(columns / ACROSS))
    if min(rows, columns) < 2 * cell:
        return 0.0
    cells = SurfaceCells.of(height, gradients, zero_um, resting, cell)
    # Cells that the field's border cuts are left out.
    whole, pixels = (slice(rows // cell), slice(columns // cell)), cell * cell
    z, across, down = (_smooth(part[whole] * np.float32(1.0 / pixels)) for part in (cells.z_px, cells.p, cells.q))
    bend = np.gradient(across, cell, axis=1) + np.gradient(down, cell, axis=0)
    top_px = float(np.percentile(z, 99.0))
    low = (z < LOW_SHARE * top_px) & (cells.count[whole] == pixels)
    free = _joined_to(low, cells.skin[whole] > 0.5 * pixels)
    if int(free.sum()) < MIN_CELLS:
        return 0.0
    left_px = _unbent_at(z[free].astype(np.float64), bend[free].astype(np.float64))
    return float(np.clip(-left_px, 0.0, MAX_SHARE * max(top_px, 0.0)) * height.pitch_um)


def _unbent_at(z: Float64Array, bend: Float64Array) -> float:
    """The height at which skin is not bent, of heights and bends of shape (N,); 0 where they tell nothing."""
    kept = np.ones(len(z), np.bool_)
    slope, start = 0.0, 0.0
    for _ in range(ROUNDS):
        slope, start = np.polyfit(z[kept], bend[kept], 1)
        off = np.abs(bend - slope * z - start)
        kept = off < OUTLIER * max(float(np.sqrt((off[kept] ** 2).mean())), 1e-12)
    if slope <= 0.0 or float(np.corrcoef(z[kept], bend[kept])[0, 1]) < MIN_CORRELATION:
        return 0.0
    return float(-start / slope)


def _joined_to(low: MaskArray, resting: MaskArray) -> MaskArray:
    """The parts of low skin, off its edges and the field's, that hold skin at rest."""
    inner = cv2.erode(low.astype(np.uint8), np.ones((5, 5), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    border = int(2 * SMOOTHING)
    inner[:border], inner[-border:], inner[:, :border], inner[:, -border:] = 0, 0, 0, 0
    _, labels = cv2.connectedComponents(inner)
    numbers = np.unique(labels[resting & (inner > 0)])
    return np.asarray(np.isin(labels, numbers[numbers > 0]))


def _smooth(values: Float32Array) -> Float32Array:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), SMOOTHING), np.float32)
