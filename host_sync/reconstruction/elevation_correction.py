"""Slopes corrected for the elevation of the skin: slopes -> heights -> what that elevation changed -> slopes.

The inverse map reads colours as if they were those of skin at the elevation of untouched skin. Skin at the elevation z
is read wrong by z times a polynomial in its own slope (`ElevationResponse.as_slopes`). Elevation is a long wave and the
error a few per cent of it, so that heights integrated once on a reduced field are enough.
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, GradientField, MaskArray
from host_sync.calibration.elevation_response import ElevationResponse
from host_sync.integration.datum import cell_sums
from host_sync.integration.smoother import CONTRACT
from host_sync.integration.zero_level import elevation_over_datum_px
from host_sync.kernels.cell_rows import bordered, cells_above, expand_cells
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

WIDEST_CELLS: Final = 512
"""Cells along the reduced field's columns, at most."""

ROUNDS: Final = 2
"""Heights from uncorrected slopes are off by some per cent, those of the second round by some per cent of that."""

HIGHEST_SHARE: Final = 0.3
"""Elevation, as a share of the lights' height, beyond which the response, linear near the skin, is not followed."""

RUN: Final = 256
"""Columns at a time: what they are corrected by stays in the first-level cache."""


def correct_elevation(
    gradients: GradientField,
    response: ElevationResponse,
    z_px: Float32Array | None = None,
    widest_cells: int = WIDEST_CELLS,
) -> Float32Array:
    """Write corrected slopes over those of a gradient field, float32 arrays of shape (H, W).

    Returns the elevation of cells over untouched skin, pixels, float32 array of shape (h, w).

    z_px : what this returned for other slopes of the same skin; None where they are the first
    widest_cells : cells along the reduced field's columns, at most
    """
    rows, columns = gradients.p.shape
    cell = -(-columns // widest_cells)
    factors = at_cells(response.as_slopes, (-(-rows // cell), -(-columns // cell)))
    if z_px is None:
        p, q, known = cell_means(gradients.p, gradients.q, gradients.valid, cell)
        z_px = elevation_px(p, q, known, float(cell), factors, response.nearness_per_px)
    parallel_rows(_correct, (rows, columns), gradients.p, gradients.q, _by_term(z_px, factors), cell)
    return z_px


def elevation_px(
    p: Float32Array, q: Float32Array, known: MaskArray, step_px: float, factors: Float32Array, nearness_per_px: float
) -> Float32Array:
    """Elevation over untouched skin, pixels, of slopes that were read as if they were untouched; arrays of one shape.

    known : where there is a slope; the skin counts as level elsewhere
    step_px : distance of neighbouring points, pixels
    factors : the response there, shape (h, w, 9)
    nearness_per_px : as of the response; bounds what is followed
    """
    highest = HIGHEST_SHARE / max(nearness_per_px, 1e-9)
    true_p, true_q = p, q
    z_px = np.zeros_like(p)
    for _ in range(ROUNDS):
        found = GradientField(true_p, true_q, known, known.astype(np.float32))
        z_px = np.clip(elevation_over_datum_px(found, step_px), -highest, highest)
        wrong_p, wrong_q = read_too_steep(p, q, z_px, factors)
        true_p, true_q = p - wrong_p, q - wrong_q
    return z_px


def read_too_steep(
    p: Float32Array, q: Float32Array, z_px: Float32Array, factors: Float32Array
) -> tuple[Float32Array, Float32Array]:
    """By how much slopes at the elevation z are read too steep; arrays of one shape, factors with 9 values each."""
    terms = np.moveaxis(factors, -1, 0)
    brighter = terms[0] + terms[1] * p + terms[2] * q
    return (
        np.asarray(z_px * (terms[3] + terms[4] * p + terms[5] * q - brighter * p), np.float32),
        np.asarray(z_px * (terms[6] + terms[7] * p + terms[8] * q - brighter * q), np.float32),
    )


def at_cells(nodes: Float32Array, shape: tuple[int, int]) -> Float32Array:
    """Values (h, w, C) at the middles of cells of what nodes, (n, m, C), hold at even places, borders included."""
    row, column = ((np.arange(n) + 0.5) * ((count - 1) / n) for n, count in zip(shape, nodes.shape[:2], strict=True))
    x, y = np.meshgrid(column.astype(np.float32), row.astype(np.float32))
    parts = [cv2.remap(np.ascontiguousarray(part), x, y, cv2.INTER_LINEAR) for part in np.moveaxis(nodes, -1, 0)]
    return np.stack(parts, axis=-1).astype(np.float32)


def cell_means(
    p: Float32Array, q: Float32Array, valid: MaskArray, cell: int
) -> tuple[Float32Array, Float32Array, MaskArray]:
    """Mean slopes of cells of `cell` x `cell` pixels, 0 for those without a slope, and which have one."""
    p_sum, q_sum, count = cell_sums(p, q, valid, cell)
    known = count > 0.0
    number: Float32Array = np.maximum(count, np.float32(1.0)).astype(np.float32)
    return np.asarray(p_sum / number, np.float32), np.asarray(q_sum / number, np.float32), known


def _by_term(z_px: Float32Array, factors: Float32Array) -> Float32Array:
    """z times factors as bordered planes of cells, one a term: shape (9, h + 2, w + 2)."""
    return bordered(np.moveaxis(z_px[..., None] * factors, -1, 0))


@njit(cache=True, nogil=True)
def _correct(p: Any, q: Any, planes: Any, cell: int, first: int, last: int) -> None:
    """Correct the rows `first` to `last` - 1."""
    columns = p.shape[1]
    upper, step = np.empty((len(planes), RUN), np.float32), np.empty((len(planes), RUN), np.float32)
    begin = first
    while begin < last:
        top, _ = cells_above(begin, cell, planes.shape[1])
        end = begin + 1
        while end < last and cells_above(end, cell, planes.shape[1])[0] == top:
            end += 1
        for start in range(0, columns, RUN):
            part = slice(start, min(start + RUN, columns))
            expand_cells(planes, top, cell, start, upper, step)
            for r in range(begin, end):
                _correct_run(p[r, part], q[r, part], upper, step, cells_above(r, cell, planes.shape[1])[1])
        begin = end


@njit(cache=True, fastmath=CONTRACT)
def _correct_run(p: Any, q: Any, upper: Any, step: Any, share: Any) -> None:
    for c in range(p.size):
        x, y = p[c], q[c]
        brighter = upper[0, c] + share * step[0, c]
        brighter += (upper[1, c] + share * step[1, c]) * x + (upper[2, c] + share * step[2, c]) * y
        across = upper[3, c] + share * step[3, c]
        across += (upper[4, c] + share * step[4, c]) * x + (upper[5, c] + share * step[5, c]) * y
        down = upper[6, c] + share * step[6, c]
        down += (upper[7, c] + share * step[7, c]) * x + (upper[8, c] + share * step[8, c]) * y
        p[c] = x - (across - brighter * x)
        q[c] = y - (down - brighter * y)
