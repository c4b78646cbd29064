"""Slopes that shrinkage took with the noise: of rough skin, whose detail is as loud as the noise.

The raw surface still holds that detail. Where its fine slopes are louder than the calibration's noise, and shrinkage
took much of them, so much of what is louder is missing in the surface with shrunk detail, and as much again of what
lens and integration kept from either. Where it took little of strong detail, what it took was noise of other planes.
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from device.surface import Float32Array
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.results.record import SlopeNoise

CELL_PX: Final = 4
PATCH_CELLS: Final = 1.5
"""Size of a cell, and standard deviation in cells of the patch over which energies are averaged."""

REACH: Final = 4
"""Pixels from a slope to the four whose mean is taken off it: what is left is fine."""

OF_NOISE: Final = np.float32(1.25)
"""Variance of what is so left of noise that does not reach so far, over the noise's own."""

LOUDER: Final = np.float32(1.5)
"""Energy of fine slopes, over that of the calibration's noise, beyond which it is detail: noise is louder in places.

On untouched skin of five rendered devices the middle of the field has 1.15 to 1.45 times it, a tenth 1.9 to 2.9.
"""

UNSEEN: Final = np.float32(2.0)
"""What is missing over what the raw surface shows of it."""

MOSTLY: Final = np.float32(0.25)
"""Share of detail's energy from which on what shrinkage takes counts as detail in full."""

SlopePair = tuple[Float32Array, Float32Array]


def lost_variance(raw: SlopePair, shrunk: SlopePair, noise: SlopeNoise) -> Float32Array:
    """Return the variance of either slope that the surface with shrunk detail lacks, on cells: float32 array (h, w).

    raw, shrunk : slopes p and q of both surfaces, float32 arrays of shape (H, W)
    noise : of the calibration
    """
    rows, columns = raw[0].shape
    shape = (-(-rows // CELL_PX), -(-columns // CELL_PX))
    planes = np.zeros((3, *shape), np.float32)
    parallel_rows(_write_energies, (shape[0], columns), *raw, *shrunk, planes)
    fine, apart, square = (cv2.GaussianBlur(plane, (0, 0), PATCH_CELLS) for plane in planes)
    fine /= OF_NOISE
    taken = np.minimum(apart / np.maximum(fine, np.float32(1e-12)), np.float32(1.0))
    louder = np.maximum(fine - LOUDER * noise.variance(square, "raw"), np.float32(0.0))
    return np.asarray(UNSEEN * taken * np.minimum(taken / MOSTLY, np.float32(1.0)) * louder, np.float32)


def with_lost_detail(sigma: Float32Array, lost: Float32Array) -> Float32Array:
    """Return the standard uncertainty of slopes, float32 array of shape (H, W), with a variance on cells beside it."""
    rows, columns = sigma.shape
    more = np.asarray(cv2.resize(lost, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)
    parallel_rows(_add_variance, sigma.shape, sigma, more)
    return more


@njit(cache=True, nogil=True)
def _write_energies(p: Any, q: Any, own_p: Any, own_q: Any, planes: Any, first: int, last: int) -> None:
    """Write mean squares of fine raw slopes, of what both differ by, and p² + q², for cells' rows from `first` on."""
    rows, columns = p.shape
    lines, detail = np.empty((3, columns), np.float32), np.empty(columns, np.float32)
    fine, apart, square = lines[0], lines[1], lines[2]
    for i in range(first, last):
        top, bottom = i * CELL_PX, min((i + 1) * CELL_PX, rows)
        lines[:] = np.float32(0.0)
        for r in range(top, bottom):
            above, below = max(r - REACH, 0), min(r + REACH, rows - 1)
            _add_row(p[above], p[r], p[below], own_p[r], detail, fine, apart, square)
            _add_row(q[above], q[r], q[below], own_q[r], detail, fine, apart, square)
        for j in range(planes.shape[2]):
            end = min((j + 1) * CELL_PX, columns)
            pixels = np.float32((bottom - top) * (end - j * CELL_PX))
            for c in range(j * CELL_PX, end):
                planes[0, i, j] += fine[c] * np.float32(0.5) / pixels
                planes[1, i, j] += apart[c] * np.float32(0.5) / pixels
                planes[2, i, j] += square[c] / pixels


@njit(cache=True)
def _add_row(above: Any, here: Any, below: Any, own: Any, detail: Any, fine: Any, apart: Any, square: Any) -> None:
    """Add a row's squares; beyond the border the outermost pixels repeat.

    detail : receives the row's fine slopes
    """
    columns = here.size
    end = max(columns - REACH, REACH)
    if end > REACH:
        inner = slice(REACH, end)
        _write_fine(above[inner], here[: end - REACH], here[inner], here[2 * REACH :], below[inner], detail[inner])
    for c in range(columns):
        if c < REACH or c >= end:
            around = above[c] + below[c] + here[max(c - REACH, 0)] + here[min(c + REACH, columns - 1)]
            detail[c] = here[c] - np.float32(0.25) * around
    _add_squares(detail, here, own, fine, apart, square)


@njit(cache=True)
def _write_fine(above: Any, left: Any, here: Any, right: Any, below: Any, detail: Any) -> None:
    for c in range(detail.size):
        detail[c] = here[c] - np.float32(0.25) * (above[c] + below[c] + left[c] + right[c])


@njit(cache=True)
def _add_squares(detail: Any, here: Any, own: Any, fine: Any, apart: Any, square: Any) -> None:
    """Add squares; what is no number, or has a neighbour that is none, counts as nothing."""
    nothing = np.float32(0.0)
    for c in range(detail.size):
        difference = here[c] - own[c]
        known = (detail[c] == detail[c]) & (difference == difference)
        fine[c] += detail[c] * detail[c] if known else nothing
        apart[c] += difference * difference if known else nothing
        square[c] += own[c] * own[c] if known else nothing


@njit(cache=True, nogil=True)
def _add_variance(sigma: Any, more: Any, first: int, last: int) -> None:
    for r in range(first, last):
        for c in range(sigma.shape[1]):
            more[r, c] = np.sqrt(sigma[r, c] * sigma[r, c] + more[r, c])
