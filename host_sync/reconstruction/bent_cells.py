"""Cells of bent skin: what their mean light hides of their slope.

A coat answers to the direction of its normal, and light adds up over a cell. The mean of unit normals, (-p, -q, 1) over
w = √(1 + p² + q²), leans less than the mean slope says: by C s / w², where C is the covariance of slopes in the cell
(Taylor's second order). On the edge of a step that is up to a micrometre of height, on a ball a thousandth of that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from device.surface.fields import Float32Array, Float64Array, GradientField
from host_sync.denoising.blur_correction import BLUR_PX
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows


def slopes_hidden_by_means(gradients: GradientField, p: Float32Array, q: Float32Array, cell: int) -> Float64Array:
    """By how much cells' mean slopes are steeper than their mean light shows: float64 array of shape (h, w, 2).

    Over a cell slopes differ as pixels show, and within a pixel as they change over the camera's blur.

    gradients : slopes of pixels
    p, q : their means over cells of `cell` x `cell` pixels, shape (h, w)
    """
    sums = np.zeros((4, *p.shape), np.float32)
    parallel_rows(_add_squares, p.shape, gradients.p, gradients.q, gradients.valid, cell, np.float32(BLUR_PX**2), sums)
    pp, pq, qq = (part / np.maximum(sums[3], np.float32(1.0)) for part in sums[:3])
    known = sums[3] > 0.0
    pp, pq, qq = (np.where(known, part, 0.0) for part in (pp - p * p, pq - p * q, qq - q * q))
    square = 1.0 + p.astype(np.float64) ** 2 + q.astype(np.float64) ** 2
    return np.stack([(pp * p + pq * q) / square, (pq * p + qq * q) / square], axis=-1)


@njit(cache=True, nogil=True)
def _add_squares(p: Any, q: Any, valid: Any, cell: int, blur: Any, sums: Any, first: int, last: int) -> None:
    """Add up p², pq, q², each with what the blur hides, and the number of valid pixels over the rows of cells."""
    rows, columns = valid.shape
    half = np.float32(0.5)
    for i in range(first, last):
        for r in range(i * cell, min((i + 1) * cell, rows)):
            above, below = max(r - 1, 0), min(r + 1, rows - 1)
            for c in range(columns):
                left, right = max(c - 1, 0), min(c + 1, columns - 1)
                if not valid[r, c]:
                    continue
                x, y = p[r, c], q[r, c]
                pp, pq, qq = x * x, x * y, y * y
                if valid[above, c] and valid[below, c] and valid[r, left] and valid[r, right]:
                    px, py = half * (p[r, right] - p[r, left]), half * (p[below, c] - p[above, c])
                    qx, qy = half * (q[r, right] - q[r, left]), half * (q[below, c] - q[above, c])
                    pp += blur * (px * px + py * py)
                    pq += blur * (px * qx + py * qy)
                    qq += blur * (qx * qx + qy * qy)
                j = c // cell
                sums[0, i, j] += pp
                sums[1, i, j] += pq
                sums[2, i, j] += qq
                sums[3, i, j] += np.float32(1.0)
