"""Confidence in slopes, evened out over neighbouring pixels.

A map weighs a pixel by that pixel's own intensity, whose noise moves the slope as well. With such weights, slopes that
noise makes steep count less than those that it makes gentle, and their weighted mean, which integration keeps, is off:
untouched skin in a dim corner of a field was 200 µm high. The mean over cells of pixels does not follow the noise of
one of them.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.surface import GradientField, MaskArray
from host_sync.kernels.cell_rows import bordered, expanded_at
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

CELL_PX: Final = 4
"""Pixels along a cell: a pixel, and its neighbours that share its noise, count little in the mean."""

MIN_OWN: Final = np.float32(0.02)
"""Weight up to which a pixel is strange by more than noise: dust, an edge. It stays, and counts for no other pixel."""


def even_confidence(gradients: GradientField, clipped: MaskArray) -> None:
    """Replace the weights of a gradient field (H, W) by their means over the cells around each pixel.

    Pixels without a slope, with a saturated channel or with hardly any weight keep theirs and count for no other pixel.

    clipped : pixels with a saturated channel, shape (H, W)
    """
    rows, columns = gradients.p.shape
    size = -(-rows // CELL_PX), -(-columns // CELL_PX)
    sums = np.zeros((2, *size), np.float32)
    parallel_rows(_sum, (size[0], CELL_PX * columns), gradients.weight, gradients.valid, clipped, sums)
    parallel_rows(_spread, (rows, columns), bordered(sums), gradients.valid, clipped, gradients.weight)


@njit(cache=True)
def _counts(valid: Any, clipped: Any, weight: Any) -> Any:
    """Return whether a pixel counts in the mean, and takes it."""
    return valid & (not clipped) & (weight > MIN_OWN)


@njit(cache=True, nogil=True)
def _sum(weight: Any, valid: Any, clipped: Any, sums: Any, first: int, last: int) -> None:
    """Add up weights, and count pixels, of rows of cells."""
    nothing, columns = np.float32(0.0), weight.shape[1]
    for i in range(first, last):
        for row in range(i * CELL_PX, min((i + 1) * CELL_PX, weight.shape[0])):
            for j in range(sums.shape[2]):
                for column in range(j * CELL_PX, min((j + 1) * CELL_PX, columns)):
                    counted = _counts(valid[row, column], clipped[row, column], weight[row, column])
                    sums[0, i, j] += weight[row, column] if counted else nothing
                    sums[1, i, j] += np.float32(counted)


@njit(cache=True, nogil=True, error_model="numpy")
def _spread(sums: Any, valid: Any, clipped: Any, weight: Any, first: int, last: int) -> None:
    """Write means of cells over the weights of rows of pixels."""
    upper, step = np.empty((2, weight.shape[1]), np.float32), np.empty((2, weight.shape[1]), np.float32)
    expanded = -1
    for row in range(first, last):
        expanded, share = expanded_at(sums, row, CELL_PX, expanded, upper, step)
        _spread_row(upper[0], step[0], upper[1], step[1], share, valid[row], clipped[row], weight[row])


@njit(cache=True, error_model="numpy")
def _spread_row(
    total: Any, total_step: Any, count: Any, count_step: Any, share: Any, valid: Any, clipped: Any, weight: Any
) -> None:
    for c in range(weight.size):
        mean = (total[c] + share * total_step[c]) / (count[c] + share * count_step[c])
        weight[c] = mean if _counts(valid[c], clipped[c], weight[c]) else weight[c]
