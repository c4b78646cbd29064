"""Cells of bent skin: what their mean light hides of their slope.

A coat answers to the direction of its normal, and light adds up over a cell. The mean of unit normals, (-p, -q, 1) over
√(1 + p² + q²), leans less than the mean slope says. On the edge of a step that hides up to a micrometre of height, on a
ball a thousandth of that.
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

MAX_SHARE: Final = 0.1
"""Share of a cell's slope that may be hidden; slopes that differ by more are misread."""


def slopes_hidden_by_means(
    gradients: GradientField, size: tuple[int, int], cell: int
) -> tuple[Float64Array, Float64Array]:
    """Return how much mean slopes of `size` (h, w) cells are steeper than their mean light shows, shape (h, w, 2).

    Over a cell slopes differ as pixels show, and within a pixel as they change over the camera's blur. The other array,
    of shape (h, w, 3), holds the covariance of the pixels' normals: of their components along columns, of both, and
    along rows.

    gradients : slopes of pixels
    cell : pixels along a cell
    """
    sums = np.zeros((12, *size), np.float32)
    step = max(1, cell // SAMPLES)
    parallel_rows(_add_normals, size, gradients.p, gradients.q, gradients.valid, cell, step, sums)
    means = sums.astype(np.float64) / np.maximum(sums[8], 1.0)
    p, q, p_normal, q_normal, normal, pp, pq, qq = means[:8]
    spread = means[9:] - np.stack([p_normal * p_normal, p_normal * q_normal, q_normal * q_normal])
    square, normal = 1.0 + p * p + q * q, np.maximum(normal, 1e-6)
    blur = 0.25 * BLUR_PX**2
    p_hidden = p - p_normal / normal + blur * (pp * p + pq * q) / square
    q_hidden = q - q_normal / normal + blur * (pq * p + qq * q) / square
    share = np.hypot(p_hidden, q_hidden) / np.maximum(np.sqrt(square - 1.0), 1e-12)
    believed = np.minimum(1.0, MAX_SHARE / np.maximum(share, 1e-12))
    return np.stack([believed * p_hidden, believed * q_hidden], axis=-1), np.moveaxis(spread, 0, -1)


@njit(cache=True, nogil=True)
def _add_normals(p: Any, q: Any, valid: Any, cell: int, step: int, sums: Any, first: int, last: int) -> None:
    """Add up slopes, normals, products of slopes' differences over two pixels, and valid pixels, in rows of cells."""
    rows, columns = valid.shape
    one = np.float32(1.0)
    own = np.empty(len(sums), np.float32)
    for i in range(first, last):
        for j in range(sums.shape[2]):
            own[:] = 0.0
            begin = step // 2 + (max(j * cell - step // 2, 0) + step - 1) // step * step
            end = min((j + 1) * cell, columns)
            for r in range(i * cell + step // 2, min((i + 1) * cell, rows), step):
                for c in range(begin, end, step):
                    if not valid[r, c]:
                        continue
                    x, y = p[r, c], q[r, c]
                    normal = one / np.sqrt(one + x * x + y * y)
                    own[0] += x
                    own[1] += y
                    own[2] += x * normal
                    own[3] += y * normal
                    own[4] += normal
                    own[8] += one
                    own[9] += x * normal * x * normal
                    own[10] += x * normal * y * normal
                    own[11] += y * normal * y * normal
                    inner = 0 < r < rows - 1 and 0 < c < columns - 1
                    if inner and valid[r - 1, c] and valid[r + 1, c] and valid[r, c - 1] and valid[r, c + 1]:
                        px, py = p[r, c + 1] - p[r, c - 1], p[r + 1, c] - p[r - 1, c]
                        qx, qy = q[r, c + 1] - q[r, c - 1], q[r + 1, c] - q[r - 1, c]
                        own[5] += px * px + py * py
                        own[6] += px * qx + py * qy
                        own[7] += qx * qx + qy * qy
            sums[:, i, j] = own
