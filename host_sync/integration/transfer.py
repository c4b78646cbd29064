"""Transfer between a level and the next coarser one: restriction sums 2x2 pixels, prolongation interpolates linearly.

Levels are cell-centred: coarse pixel (R, C) covers the fine pixels (2R, 2C) to (2R+1, 2C+1), fewer at an odd end. A
fine pixel takes its own coarse value and a quarter of the difference to each coarse neighbour on its side,

    z = z₀ + s_h (z_h - z₀) / 4 + s_v (z_v - z₀) / 4,

with s = 1 where a fine edge crosses and s = 0 beside a hole. (Letting s follow the weights as well changed no measured
rate of convergence.)

The last correction of the finest level is added without smoothing after it (`add_correction`). Most of the cost of a
pass over the pixels is building edges, which only smoothing needs; the roughness that interpolation leaves is small
beside the correction, which is small beside noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from device.surface import Float32Array, Float64Array
from host_sync.integration.components import Components, row_moments
from host_sync.integration.levels import first_of, second_of
from host_sync.integration.smoother import CONTRACT
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows


@njit(cache=True)
def copy_row(source: Any, start: int, out: Any, at: int, size: int) -> None:
    """Copy `size` pixels of a row; slices that begin at 0 let the loop compile to vector code."""
    these, those = source[start : start + size], out[at : at + size]
    for c in range(size):
        those[c] = these[c]


@njit(cache=True)
def restrict_row(fine: Any, add: bool, out: Any) -> None:
    """Write (or add) the sums of neighbouring pairs of a fine row to a coarse one."""
    pairs = fine.size // 2
    if add:
        for c in range(pairs):
            out[c] += fine[2 * c] + fine[2 * c + 1]
    else:
        for c in range(pairs):
            out[c] = fine[2 * c] + fine[2 * c + 1]
    if fine.size > 2 * pairs:
        out[pairs] = fine[fine.size - 1] + (out[pairs] if add else np.float32(0.0))


@njit(cache=True, fastmath=CONTRACT)
def prolong_row(near: Any, far: Any, out: Any) -> None:
    """Add a row interpolated on a full grid; `near` and `far` are the coarse rows of z₀ and z_v, `out` is padded."""
    quarter, width, last = np.float32(0.25), out.size - 2, near.size - 1
    for c in range(1, last):
        z = near[c]
        base = z + quarter * (far[c] - z)
        out[2 * c + 1] += base + quarter * (near[c - 1] - z)
        out[2 * c + 2] += base + quarter * (near[c + 1] - z)
    for end in (0, last):
        for c in range(2 * end, min(2 * end + 2, width)):
            z = near[end]
            side = near[min(max(end + 2 * (c % 2) - 1, 0), last)]
            out[c + 1] += (z + quarter * (far[end] - z)) + quarter * (side - z)
        if last == 0:
            break


@njit(cache=True, fastmath=CONTRACT)
def prolong_weighted_row(near: Any, far: Any, weight_x: Any, over: Any, out: Any) -> None:
    """Add a row that is interpolated across existing edges.

    weight_x : of the row itself
    over : weights to the next fine row towards `far`
    """
    quarter, zero = np.float32(0.25), np.float32(0.0)
    width, last, behind = out.size - 2, near.size - 1, weight_x[1:]
    for c in range(1, last):
        z = near[c]
        up, left, right = quarter * (far[c] - z), quarter * (near[c - 1] - z), quarter * (near[c + 1] - z)
        first = z + (up if over[2 * c] > zero else zero)
        second = z + (up if over[2 * c + 1] > zero else zero)
        out[2 * c + 1] += first + (left if first_of(weight_x, c) > zero else zero)
        out[2 * c + 2] += second + (right if second_of(behind, c) > zero else zero)
    for end in (0, last):
        for c in range(2 * end, min(2 * end + 2, width)):
            z, odd = near[end], c % 2
            side = near[min(max(end + 2 * odd - 1, 0), last)]
            base = z + (quarter * (far[end] - z) if over[c] > zero else zero)
            out[c + 1] += base + (quarter * (side - z) if weight_x[c + odd] > zero else zero)
        if last == 0:
            break


@njit(cache=True)
def add_cells(coarse: Any, out: Any) -> None:
    """Add a coarse row to both fine pixels of each cell of a padded row."""
    width = out.size - 2
    for c in range(width // 2):
        out[2 * c + 1] += coarse[c]
        out[2 * c + 2] += coarse[c]
    if width % 2:
        out[width] += coarse[width // 2]


def add_correction(z: Float32Array, coarse: Float32Array) -> None:
    """Add heights of the next level, interpolated, to those of the pixels, in place.

    z : float32 array of shape (H, W)
    coarse : float32 array of shape (ceil(H / 2), ceil(W / 2))
    """
    parallel_rows(_add_rows, z.shape, z, coarse, *(None,) * 5)


def add_weighted_correction(
    z: Float32Array, coarse: Float32Array, weight: Float32Array, components: Components
) -> Float64Array:
    """Add a correction between holes, and return the moments Σ w z of the corrected heights.

    weight : float32 array of shape (H, W), 0 at holes, across which nothing is interpolated
    """
    moments = np.empty(components.start.size)
    parallel_rows(_add_rows, z.shape, z, coarse, weight, components.first, components.start, components.stop, moments)
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
    """Add a row interpolated from its cells `near` and the next ones, `far`, where neither neighbour is a hole.

    weight, beyond : weights of the row and of the next one towards `far`. (Values at holes do not matter.)
    """
    quarter, zero = np.float32(0.25), np.float32(0.0)
    whole = max(z.size // 2 - 2, 0)
    _add_cell(0, near, far, weight, beyond, z)
    for cell in range(whole + 1, near.size):
        _add_cell(cell, near, far, weight, beyond, z)
    middle, behind, above, z = near[1:], near[2:], far[1:], z[2:]
    after, beyond = weight[4:], beyond[2:]
    for i in range(whole):
        m = middle[i]
        up, left, right = quarter * (above[i] - m), quarter * (near[i] - m), quarter * (behind[i] - m)
        first = m + (up if beyond[2 * i] > zero else zero)
        second = m + (up if beyond[2 * i + 1] > zero else zero)
        z[2 * i] += first + (left if second_of(weight, i) > zero else zero)
        z[2 * i + 1] += second + (right if first_of(after, i) > zero else zero)


@njit(cache=True, fastmath=CONTRACT)
def _add_cell(cell: int, near: Any, far: Any, weight: Any, beyond: Any, z: Any) -> None:
    """Add one cell as `_add_row` does, which may be at an end of the row."""
    quarter, zero, last = np.float32(0.25), np.float32(0.0), near.size - 1
    for c in range(2 * cell, min(2 * cell + 2, z.size)):
        towards = 2 * (c % 2) - 1
        up, side = far[cell] - near[cell], near[min(max(cell + towards, 0), last)] - near[cell]
        base = near[cell] + (quarter * up if beyond[c] > zero else zero)
        over = weight[min(max(c + towards, 0), z.size - 1)] > zero
        z[c] += base + (quarter * side if over else zero)
