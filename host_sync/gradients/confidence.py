"""Confidence in slopes, evened out over neighbouring pixels, and the mark of extrapolated ones.

A map weighs a pixel by that pixel's own intensity, whose noise moves the slope as well. With such weights, slopes that
noise makes steep count less than those that it makes gentle, and their weighted mean, which integration keeps, is off:
untouched skin in a dim corner of a field was 200 µm high. The mean over cells of pixels does not follow the noise of
one of them.

Extrapolated pixels are steeper than any ball, or of a colour and place whose leverage exceeds that of every ball pixel
(`device.inverse_map.training_domain`). They are kept. Leverage is computed on a coarse grid and holds for the block of
pixels around each of its points.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.inverse_map.regressor import blocks_of, field_position
from device.surface import Float32Array, GradientField, MaskArray
from host_sync.kernels.cell_rows import bordered, expanded_at
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

CELL_PX: Final = 4
"""Pixels along a cell: a pixel, and its neighbours that share its noise, count little in the mean."""

MIN_OWN: Final = np.float32(0.02)
"""Weight up to which a pixel is out of domain by more than noise: dust, an edge. It counts for no other pixel."""


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


MAX_POINTS: Final = 60_000
"""Points of the coarse grid, at most: each costs as many products as the map has features squared."""

MAX_LEVERAGE: Final = 2.0
"""Leverage, relative to the highest of the training balls, from which a pixel is extrapolated."""

STEEPER: Final = 1.05
"""Slope, relative to the steepest that balls showed, from which it is: noise alone passes 1 at the rim of a ball."""

_CHUNK: Final = 8192


def extrapolated(
    intensity: NormalizedImage,
    inverse: InverseMap,
    p: Float32Array,
    q: Float32Array,
    blocks: MaskArray | None = None,
) -> MaskArray:
    """Return True where a slope lies beyond the calibration's training data, shape (H, W).

    p, q : float32 arrays of shape (H, W), slopes of the surface, NaN where invalid
    blocks : `out_of_domain_blocks` of the image, where it was computed before
    """
    out = np.empty(intensity.shape, np.bool_)
    limit = np.float32((STEEPER * inverse.max_trained_slope) ** 2)
    blocks = out_of_domain_blocks(intensity, inverse) if blocks is None else blocks
    parallel_rows(_mark, out.shape, p, q, limit, blocks, _step(intensity.shape), out)
    return out


@njit(cache=True, nogil=True)
def _mark(p: Any, q: Any, limit: Any, blocks: Any, step: int, out: Any, first: int, last: int) -> None:
    """Write where slopes are steep or blocks of `step` pixels out of domain, and there is a surface at all."""
    columns = out.shape[1]
    block = np.empty(columns, np.bool_)
    for r in range(first, last):
        for c in range(columns):
            block[c] = blocks[r // step, c // step]
        _mark_row(p[r], q[r], limit, block, out[r])


@njit(cache=True)
def _mark_row(p: Any, q: Any, limit: Any, block: Any, out: Any) -> None:
    for c in range(out.size):
        steep = p[c] * p[c] + q[c] * q[c] > limit
        out[c] = (steep | block[c]) & np.isfinite(p[c])


def out_of_domain_blocks(intensity: NormalizedImage, inverse: InverseMap) -> MaskArray:
    """Return the blocks of pixels whose leverage lies beyond the training data: bool array (h, w).

    Leverage is computed at one point of every block.
    """
    step = _step(intensity.shape)
    rows, columns = intensity.shape
    values = intensity.values[step // 2 :: step, step // 2 :: step]
    # A last block that is cut before its middle has no point of its own.
    height, width = -(-rows // step), -(-columns // step)
    blocks = np.zeros((height, width), np.bool_)
    if inverse.leverage is None:
        return blocks
    seen_rows, seen_columns, _ = values.shape
    found = np.zeros((seen_rows, seen_columns), np.bool_)
    across = np.arange(seen_columns) * step + step // 2
    down = np.arange(seen_rows) * step + step // 2
    column, row = (axis.ravel().astype(np.float64) for axis in np.meshgrid(across, down))
    place = field_position(column, row, inverse.shape)
    colours = np.ascontiguousarray(values).reshape(-1, 3)
    flat = found.ravel()
    for part in blocks_of(len(colours), _CHUNK):
        flat[part] = inverse.leverage.relative(inverse.curve, colours[part], place[part]) > MAX_LEVERAGE
    blocks[:seen_rows, :seen_columns] = flat.reshape(found.shape)
    return blocks


def _step(shape: tuple[int, int]) -> int:
    return max(1, int(np.ceil(np.sqrt(shape[0] * shape[1] / MAX_POINTS))))
