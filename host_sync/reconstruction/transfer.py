"""Between a level and the next coarser one: restriction sums 2x2 pixels, prolongation interpolates linearly.

Levels are cell-centred: coarse pixel (R, C) covers the fine pixels (2R, 2C) to (2R+1, 2C+1), fewer at an odd end.
A fine pixel takes its own coarse value and a quarter of the way to each coarse neighbour on its side,

    z = z₀ + s_h (z_h - z₀) / 4 + s_v (z_v - z₀) / 4,

with s = 1 where a fine edge leads over and s = 0 beside a hole. (Letting s follow the weights as well changed no rate
of convergence that was measured.)
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from host_sync.reconstruction.pixel_pairs import first_of, second_of
from host_sync.reconstruction.smoother import CONTRACT


@njit(cache=True)
def copy_row(source: Any, start: int, out: Any, at: int, size: int) -> None:
    """Copy `size` pixels of a row; a loop over parts that begin at nought, for only such loops become vector code."""
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
def prolong_weighted_row(near: Any, far: Any, across: Any, over: Any, out: Any) -> None:
    """Add a row interpolated where edges lead over.

    `across` are the row's own edges, `over` the edges to the fine row beyond, towards `far`.
    """
    quarter, nought = np.float32(0.25), np.float32(0.0)
    width, last, behind = out.size - 2, near.size - 1, across[1:]
    for c in range(1, last):
        z = near[c]
        up, left, right = quarter * (far[c] - z), quarter * (near[c - 1] - z), quarter * (near[c + 1] - z)
        first = z + (up if over[2 * c] > nought else nought)
        second = z + (up if over[2 * c + 1] > nought else nought)
        out[2 * c + 1] += first + (left if first_of(across, c) > nought else nought)
        out[2 * c + 2] += second + (right if second_of(behind, c) > nought else nought)
    for end in (0, last):
        for c in range(2 * end, min(2 * end + 2, width)):
            z, odd = near[end], c % 2
            side = near[min(max(end + 2 * odd - 1, 0), last)]
            base = z + (quarter * (far[end] - z) if over[c] > nought else nought)
            out[c + 1] += base + (quarter * (side - z) if across[c + odd] > nought else nought)
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
