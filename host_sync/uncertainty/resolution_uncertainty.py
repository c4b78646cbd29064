"""Uncertainty from the resolution of camera and pipeline: error of slopes where they bend within few pixels.

A blur of standard deviation s takes ½ s² ∇²p from a slope p, to first order: at edges, and of a wave of 10 px a sixth
of its slope with s = 1 px. The sharpness of a lens is not known, so that this is no correction but an uncertainty.
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from device.surface.fields import Float32Array
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

BLUR_PX: Final = 1.0
"""Standard deviation of everything that blurs: a lens that suits its pixels has 0.5 to 0.6 px, demosaicing, integration
and central differences 0.5 px, and shrinkage of what is near the noise takes as much again."""

CELL_PX: Final = 4
PATCH_CELLS: Final = 1.0
"""Size of a cell, and standard deviation in cells of the patch over which what is lost is averaged."""

REACH: Final = 2
"""Pixels between the points of a second difference: noise from pixel to pixel is no bend."""


def unresolved_slope(p: Float32Array, q: Float32Array) -> Float32Array:
    """Return the standard deviation of either slope that was not resolved, on cells: float32 array of shape (h, w).

    p, q : slopes of the surface, float32 arrays of shape (H, W)
    """
    rows, columns = p.shape
    shape = (-(-rows // CELL_PX), -(-columns // CELL_PX))
    square = np.zeros(shape, np.float32)
    parallel_rows(_write_bends, (shape[0], columns), p, q, square)
    patch = cv2.GaussianBlur(square, (0, 0), PATCH_CELLS)
    return np.asarray(np.float32(0.5 * BLUR_PX**2) * np.sqrt(patch), np.float32)


@njit(cache=True, nogil=True)
def _write_bends(p: Any, q: Any, square: Any, first: int, last: int) -> None:
    """Write the mean square of either slope's Laplacian for the rows `first` to `last` - 1 of cells."""
    rows, columns = p.shape
    line = np.empty(columns, np.float32)
    for i in range(first, last):
        top, bottom = i * CELL_PX, min((i + 1) * CELL_PX, rows)
        line[:] = np.float32(0.0)
        for r in range(top, bottom):
            above, below = max(r - REACH, 0), min(r + REACH, rows - 1)
            _add_bends(p[above], p[r], p[below], line)
            _add_bends(q[above], q[r], q[below], line)
        for j in range(square.shape[1]):
            end = min((j + 1) * CELL_PX, columns)
            total = np.float32(0.0)
            for c in range(j * CELL_PX, end):
                total += line[c]
            square[i, j] = total * np.float32(0.5) / np.float32((bottom - top) * (end - j * CELL_PX))


@njit(cache=True)
def _add_bends(above: Any, here: Any, below: Any, line: Any) -> None:
    """Add the squares of a row's Laplacians; what has a neighbour that is no number counts as straight."""
    per_square = np.float32(1.0 / REACH**2)
    for c in range(REACH, here.size - REACH):
        bend = above[c] + below[c] + here[c - REACH] + here[c + REACH] - np.float32(4.0) * here[c]
        bend *= per_square
        line[c] += bend * bend if bend == bend else np.float32(0.0)
