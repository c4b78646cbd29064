"""Pixels with slopes beyond the calibration's training data: they are kept, and marked.

Steeper than any ball, or of a colour and place whose leverage exceeds that of every ball pixel
(`device.inverse_map.training_domain`).
Leverage is looked at on a coarse grid and holds for the block of pixels around each of its points.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.inverse_map.regressor import field_position
from device.surface import Float32Array, MaskArray
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

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
    strange: MaskArray | None = None,
) -> MaskArray:
    """Return True where a slope lies beyond the calibration's training data, shape (H, W).

    p, q : float32 arrays of shape (H, W), slopes of the surface, NaN where invalid
    strange : `strange_blocks` of the image, where it was computed before
    """
    out = np.empty(intensity.shape, np.bool_)
    limit = np.float32((STEEPER * inverse.max_trained_slope) ** 2)
    blocks = strange_blocks(intensity, inverse) if strange is None else strange
    parallel_rows(_mark, out.shape, p, q, limit, blocks, _step(intensity.shape), out)
    return out


@njit(cache=True, nogil=True)
def _mark(p: Any, q: Any, limit: Any, strange: Any, step: int, out: Any, first: int, last: int) -> None:
    """Write where slopes are steep or blocks of `step` pixels strange, and there is a surface at all."""
    columns = out.shape[1]
    block = np.empty(columns, np.bool_)
    for r in range(first, last):
        for c in range(columns):
            block[c] = strange[r // step, c // step]
        _mark_row(p[r], q[r], limit, block, out[r])


@njit(cache=True)
def _mark_row(p: Any, q: Any, limit: Any, block: Any, out: Any) -> None:
    for c in range(out.size):
        steep = p[c] * p[c] + q[c] * q[c] > limit
        out[c] = (steep | block[c]) & np.isfinite(p[c])


def strange_blocks(intensity: NormalizedImage, inverse: InverseMap) -> MaskArray:
    """Return the blocks of pixels whose leverage lies beyond the training data: bool array (h, w).

    Leverage is computed at one point of every block.
    """
    step = _step(intensity.shape)
    rows, columns = intensity.shape
    values = intensity.values[step // 2 :: step, step // 2 :: step]
    # A last block that is cut before its middle has no point of its own.
    height, width = -(-rows // step), -(-columns // step)
    strange = np.zeros((height, width), np.bool_)
    if inverse.leverage is None:
        return strange
    seen_rows, seen_columns, _ = values.shape
    found = np.zeros((seen_rows, seen_columns), np.bool_)
    across = np.arange(seen_columns) * step + step // 2
    down = np.arange(seen_rows) * step + step // 2
    column, row = (axis.ravel().astype(np.float64) for axis in np.meshgrid(across, down))
    place = field_position(column, row, inverse.shape)
    colours = np.ascontiguousarray(values).reshape(-1, 3)
    flat = found.ravel()
    for start in range(0, len(colours), _CHUNK):
        part = slice(start, start + _CHUNK)
        flat[part] = inverse.leverage.relative(inverse.curve, colours[part], place[part]) > MAX_LEVERAGE
    strange[:seen_rows, :seen_columns] = flat.reshape(found.shape)
    return strange


def _step(shape: tuple[int, int]) -> int:
    return max(1, int(np.ceil(np.sqrt(shape[0] * shape[1] / MAX_POINTS))))
