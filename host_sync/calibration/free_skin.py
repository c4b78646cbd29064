"""Correction of the reference from the free skin of all presses.

One frame of untouched skin has noise of its own, whose long waves add up to height: the same in every scan, as much as
0.6 µm on a quiet sensor. Far from their balls presses show untouched skin again. What the map reads there, as far as
the presses agree, is taken off all slopes. Where presses show too little free skin, differ, or show more than a
reference's noise can be, nothing is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import Ball
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import REST_NODES, InverseMap
from device.surface.fields import Float32Array, Float64Array, MaskArray
from host_sync.gradients.cell_slopes import cell_slopes
from host_sync.kernels.cell_rows import middles_of_cells

FREE_RADII: Final = 4.0
"""Distance from a ball's centre, in contact radii, from which skin is untouched."""

MAX_SLOPE: Final = 0.03
"""Steeper skin is not untouched, or is another gel's."""

MAX_MISSED: Final = 0.004
"""Root mean square slope that a reference's noise may be read as; more is skin that changed since.

Rendered sensors show 0.0003 to 0.0023, a real one whose skin drifts from press to press 0.011.
"""

MAX_CELLS: Final = 40_000
"""A press is reduced to so many cells at most."""

MIN_CELLS: Final = 12
"""Cells of a press around a node that tell its slope."""

MIN_PRESSES: Final = 4
MEDIAN_VARIANCE: Final = 1.5
"""Variance of a median over that of a mean, about π / 2."""

Pressed = Sequence[tuple[NormalizedImage, Sequence[Ball]]]


def with_free_skin(inverse_map: InverseMap, pressed: Pressed) -> InverseMap:
    """Return the map less what it reads on the free skin of presses, in `noise_bias`.

    pressed : intensity and every ball of each press
    """
    bias = inverse_map.noise_bias
    shape = _node_shape(inverse_map) if bias is None else (bias.shape[0], bias.shape[1])
    read = free_skin_slopes(inverse_map, pressed, shape)
    return replace(inverse_map, noise_bias=read if bias is None else np.asarray(bias + read, np.float32))


def free_skin_slopes(inverse_map: InverseMap, pressed: Pressed, shape: tuple[int, int]) -> Float32Array:
    """Return slopes that presses agree on where their skin is free, at nodes even over the field: float32 array (h, w,
    2).

    Each node's median over presses is reduced by the share of its square that is noise; 0 where fewer than
    `MIN_PRESSES` show free skin.
    """
    parts = [_at_nodes(inverse_map, image, balls, shape) for image, balls in pressed if balls]
    if len(parts) < MIN_PRESSES:
        return np.zeros((*shape, 2), np.float32)
    stack = np.stack(parts)
    count = np.isfinite(stack[..., 0]).sum(axis=0)
    shown = count >= MIN_PRESSES
    median, spread = np.zeros((*shape, 2)), np.ones((*shape, 2))
    median[shown] = np.nanmedian(stack[:, shown], axis=0)
    spread[shown] = np.nanvar(stack[:, shown], axis=0)
    noise = MEDIAN_VARIANCE * spread.sum(axis=-1) / np.maximum(count - 1, 1)
    square = (median**2).sum(axis=-1)
    believed = np.where(shown, square / np.maximum(square + noise, 1e-30), 0.0)
    if not shown.any() or np.sqrt(square[shown].mean()) > MAX_MISSED:
        return np.zeros((*shape, 2), np.float32)
    return np.asarray(median * believed[..., None], np.float32)


def _at_nodes(
    inverse_map: InverseMap, image: NormalizedImage, balls: Sequence[Ball], shape: tuple[int, int]
) -> Float64Array:
    """Return the mean slopes of a press's free skin around each node, float64 array (h, w, 2), NaN where there is too
    little."""
    rows, columns = image.shape
    step = max(int(np.ceil(np.sqrt(rows * columns / MAX_CELLS))), 1)
    read = cell_slopes(image, inverse_map, step)
    down, across = middles_of_cells(read.p.shape, step)
    free = read.valid & (np.hypot(read.p, read.q) < MAX_SLOPE) & _far(balls, across, down)
    node = [
        np.rint(at / max(size - 1, 1) * (count - 1)).astype(np.intp).clip(0, count - 1)
        for at, size, count in zip((down, across), (rows, columns), shape, strict=True)
    ]
    index = (node[0][:, None] * shape[1] + node[1])[free]
    total = shape[0] * shape[1]
    number = np.bincount(index, minlength=total)
    sums = [np.bincount(index, slopes[free], total) for slopes in (read.p, read.q)]
    mean = np.stack(sums, axis=-1) / np.maximum(number, 1)[:, None]
    mean[number < MIN_CELLS] = np.nan
    return np.asarray(mean.reshape(*shape, 2))


def _far(balls: Sequence[Ball], across: NDArray[np.floating], down: NDArray[np.floating]) -> MaskArray:
    """Return where no ball has touched: bool array (h, w)."""
    far = np.ones((len(down), len(across)), np.bool_)
    for ball in balls:
        distance = np.hypot(across[None] - ball.column, down[:, None] - ball.row)
        far &= distance > FREE_RADII * ball.contact_radius_px
    return far


def _node_shape(inverse_map: InverseMap) -> tuple[int, int]:
    rows, columns = inverse_map.shape
    return max(round(REST_NODES * rows / columns), 2), REST_NODES
