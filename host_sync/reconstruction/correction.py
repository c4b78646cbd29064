"""The last step of the finest level: a correction is interpolated and added, and nothing is smoothed after it.

What a pass over the pixels costs is mostly their edges, which smoothing needs and this does not. What interpolation
leaves uneven is small beside the correction, which is small beside noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from device.surface import Float32Array, Float64Array
from host_sync.reconstruction.islands import Islands, row_moments
from host_sync.reconstruction.pixel_pairs import first_of, second_of
from host_sync.reconstruction.row_bands import in_bands
from host_sync.reconstruction.smoother import CONTRACT


def add_correction(z: Float32Array, coarse: Float32Array) -> None:
    """Add heights of the next level to those of the pixels, in place.

    z : float32 array of shape (H, W)
    coarse : float32 array of shape (ceil(H / 2), ceil(W / 2))
    """
    in_bands(_add_rows, z.shape, z, coarse, *(None,) * 5)


def add_weighted_correction(
    z: Float32Array, coarse: Float32Array, weight: Float32Array, islands: Islands
) -> Float64Array:
    """As `add_correction`, between holes; returns the moments of the heights then, while they are at hand.

    weight : float32 array of shape (H, W), nought at holes, over which nothing is interpolated
    """
    moments = np.empty(islands.start.size)
    in_bands(_add_rows, z.shape, z, coarse, weight, islands.first, islands.start, islands.stop, moments)
    return moments


@njit(cache=True, nogil=True)
def _add_rows(
    z: Any, coarse: Any, weight: Any, run: Any, start: Any, stop: Any, moments: Any, first: int, last: int
) -> None:  # fmt: skip
    everywhere = np.ones(z.shape[1], np.float32)
    for r in range(first, last):
        towards = 2 * (r % 2) - 1
        near, far = coarse[r // 2], coarse[min(max(r // 2 + towards, 0), coarse.shape[0] - 1)]
        if weight is None:
            _add_row(near, far, everywhere, everywhere, z[r])
        else:
            _add_row(near, far, weight[r], weight[min(max(r + towards, 0), z.shape[0] - 1)], z[r])
            row_moments(z[r], weight[r], run[r], run[r + 1], start, stop, moments)


@njit(cache=True, fastmath=CONTRACT)
def _add_row(near: Any, far: Any, weight: Any, beyond: Any, z: Any) -> None:
    """Add a row interpolated from its cells `near` and those `far`, where neither neighbour is a hole.

    weight, beyond : weights of the row and of the next one towards `far`. (What a hole itself gets is of no account.)
    """
    quarter, nought = np.float32(0.25), np.float32(0.0)
    whole = max(z.size // 2 - 2, 0)
    _add_cell(0, near, far, weight, beyond, z)
    for cell in range(whole + 1, near.size):
        _add_cell(cell, near, far, weight, beyond, z)
    middle, behind, above, z = near[1:], near[2:], far[1:], z[2:]
    after, beyond = weight[4:], beyond[2:]
    for i in range(whole):
        m = middle[i]
        up, left, right = quarter * (above[i] - m), quarter * (near[i] - m), quarter * (behind[i] - m)
        first = m + (up if beyond[2 * i] > nought else nought)
        second = m + (up if beyond[2 * i + 1] > nought else nought)
        z[2 * i] += first + (left if second_of(weight, i) > nought else nought)
        z[2 * i + 1] += second + (right if first_of(after, i) > nought else nought)


@njit(cache=True, fastmath=CONTRACT)
def _add_cell(cell: int, near: Any, far: Any, weight: Any, beyond: Any, z: Any) -> None:
    """The same for one cell, which may lie at an end of the row."""
    quarter, nought, last = np.float32(0.25), np.float32(0.0), near.size - 1
    for c in range(2 * cell, min(2 * cell + 2, z.size)):
        towards = 2 * (c % 2) - 1
        up, side = far[cell] - near[cell], near[min(max(cell + towards, 0), last)] - near[cell]
        base = near[cell] + (quarter * up if beyond[c] > nought else nought)
        over = weight[min(max(c + towards, 0), z.size - 1)] > nought
        z[c] += base + (quarter * side if over else nought)
