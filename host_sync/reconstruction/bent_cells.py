"""Cells of bent skin: what their mean light hides of their slope.

A coat answers to the direction of its normal, and light adds up over a cell. The mean of unit normals, (-p, -q, 1) over
w = √(1 + p² + q²), leans less than the mean slope says: by C s / w², where C is the covariance of slopes in the cell
(Taylor's second order). On the edge of a step that is up to a micrometre of height, on a ball a thousandth of that.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.surface.fields import Float64Array, GradientField
from host_sync.denoising.blur_correction import BLUR_PX
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

SAMPLES: Final = 4
"""Pixels along a cell whose slopes are asked, at least."""


def slopes_hidden_by_means(gradients: GradientField, size: tuple[int, int], cell: int) -> Float64Array:
    """By how much mean slopes of `size` (h, w) cells are steeper than their mean light shows: float64 array (h, w, 2).

    Over a cell slopes differ as pixels show, and within a pixel as they change over the camera's blur.

    gradients : slopes of pixels
    cell : pixels along a cell
    """
    sums = np.zeros((6, *size), np.float32)
    blur, step = np.float32(BLUR_PX**2), max(1, cell // SAMPLES)
    parallel_rows(_add_squares, size, gradients.p, gradients.q, gradients.valid, cell, step, blur, sums)
    p, q, pp, pq, qq = sums[:5] / np.maximum(sums[5], np.float32(1.0))
    pp, pq, qq = pp - p * p, pq - p * q, qq - q * q
    square = 1.0 + p * p + q * q
    return np.stack([(pp * p + pq * q) / square, (pq * p + qq * q) / square], axis=-1).astype(np.float64)


@njit(cache=True, nogil=True)
def _add_squares(p: Any, q: Any, valid: Any, cell: int, step: int, blur: Any, sums: Any, first: int, last: int) -> None:
    """Add up p, q, p², pq, q² (with what the blur hides) and the number of valid pixels over rows of cells."""
    rows, columns = valid.shape
    quarter = np.float32(0.25) * blur
    for i in range(first, last):
        for r in range(i * cell + step // 2, min((i + 1) * cell, rows), step):
            for c in range(step // 2, columns, step):
                if not valid[r, c]:
                    continue
                x, y = p[r, c], q[r, c]
                pp, pq, qq = x * x, x * y, y * y
                inner = 0 < r < rows - 1 and 0 < c < columns - 1
                if inner and valid[r - 1, c] and valid[r + 1, c] and valid[r, c - 1] and valid[r, c + 1]:
                    px, py = p[r, c + 1] - p[r, c - 1], p[r + 1, c] - p[r - 1, c]
                    qx, qy = q[r, c + 1] - q[r, c - 1], q[r + 1, c] - q[r - 1, c]
                    pp += quarter * (px * px + py * py)
                    pq += quarter * (px * qx + py * qy)
                    qq += quarter * (qx * qx + qy * qy)
                j = c // cell
                sums[0, i, j] += x
                sums[1, i, j] += y
                sums[2, i, j] += pp
                sums[3, i, j] += pq
                sums[4, i, j] += qq
                sums[5, i, j] += np.float32(1.0)
