"""Candidates, refinement and gate of every pixel in one pass over the intensity (paper, section 5.1).

A row is processed in tiles that stay in cache: intensity gradients, table lookup, then arithmetic over planes of the
tile. The few pixels of ambiguous bins are visited again, candidate by candidate.

Intensity gradients are Sobel's, central differences averaged over three rows or columns (1, 2, 1): ε selects between
candidates and must not depend on a pixel's own noise.

The tile is allocated inside the function with the loops: its constant shape proves to the compiler that its planes do
not overlap, without which there is no SIMD code (six times slower).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.surface.fields import Float32Array, MaskArray
from host_sync.johnson2009.lookup_table import LookupTable
from host_sync.johnson2009.refinement import GateSettings, judge_candidate
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

SOBEL_VARIANCE: Final = 0.1875
"""Variance of an intensity gradient relative to that of a pixel: 1/2 for a central difference times 3/8 for the (1, 2,
1) mean."""

_TILE: Final = 256
_COLOUR: Final = 11
_ACROSS: Final = 14
_DOWN: Final = 17
_RESULT: Final = 20
_PLANES: Final = 23
"""Planes of a tile: candidate (11), intensity (3), ∂I/∂x (3), ∂I/∂y (3), and the results p, q, confidence."""

_FAST = {"contract", "arcp", "nsz"}


def estimate_slopes(
    values: Float32Array,
    lit: MaskArray,
    table: LookupTable,
    settings: GateSettings,
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Slopes p, q and confidence of every pixel, float32 arrays of shape (H, W); confidence 0 where p, q are invalid.

    values : float32 array of shape (H, W, 3), intensity
    lit : bool array of shape (H, W), where intensity is valid
    """
    p, q, confidence = (np.zeros(lit.shape, np.float32) for _ in range(3))
    parallel_rows(_estimate_rows, lit.shape, values, lit, table, settings, p, q, confidence)
    return p, q, confidence


@njit(cache=True, nogil=True)
def _estimate_rows(
    values: Any, lit: Any, table: Any, settings: Any, p: Any, q: Any, confidence: Any, begin: int, end: int
) -> None:  # fmt: skip
    """Write slopes and confidence of the rows `begin` to `end` - 1."""
    for row in range(begin, end):
        for start in range(0, values.shape[1], _TILE):
            _estimate_tile(values, lit, table, settings, np.int64(row), start, p, q, confidence)


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _estimate_tile(
    values: Any, lit: Any, table: Any, settings: Any, row: Any, start: int, p: Any, q: Any, confidence: Any
) -> None:  # fmt: skip
    """Write slopes and confidence of up to `_TILE` pixels of a row from column `start`."""
    first, candidates = table.first, table.candidates
    tile = np.empty((_PLANES, _TILE), np.float32)
    filled, entry = np.empty(_TILE, np.int32), np.empty(_TILE, np.int32)
    count = min(_TILE, values.shape[1] - start)
    _write_intensity(values, row, start, count, tile)
    _write_gradients(values, row, start, count, tile)
    _look_up(tile, count, table.low, table.step, table.bin_of, filled)
    for c in range(count):
        entry[c] = first[filled[c]]
    for field in range(_COLOUR):
        for c in range(count):
            tile[field, c] = candidates[entry[c], field]
    for c in range(_TILE):
        best = judge_candidate(
            (tile[0, c], tile[1, c], tile[2, c], tile[3, c], tile[4, c], tile[5, c],
             tile[6, c], tile[7, c], tile[8, c], tile[9, c], tile[10, c]),
            (tile[11, c], tile[12, c], tile[13, c]),
            (tile[14, c], tile[15, c], tile[16, c]),
            (tile[17, c], tile[18, c], tile[19, c]),
            settings,
        )  # fmt: skip
        tile[20, c], tile[21, c], tile[22, c] = best[0], best[1], best[2]
    for c in range(count):
        if first[filled[c] + 1] - first[filled[c]] > 1:
            _choose(tile, c, first[filled[c]], first[filled[c] + 1], candidates, settings)
    for c in range(count):
        if lit[row, start + c] and np.isfinite(tile[11, c] + tile[12, c] + tile[13, c]):
            p[row, start + c], q[row, start + c] = tile[_RESULT, c], tile[_RESULT + 1, c]
            confidence[row, start + c] = tile[_RESULT + 2, c]


@njit(cache=True)
def _write_intensity(values: Any, row: int, start: int, count: int, tile: Any) -> None:
    for channel in range(3):
        for c in range(count):
            tile[_COLOUR + channel, c] = values[row, start + c, channel]


@njit(cache=True, fastmath=_FAST)
def _write_gradients(values: Any, row: int, start: int, count: int, tile: Any) -> None:
    """Write ∂I/∂x and ∂I/∂y, with borders repeated."""
    rows, columns, _ = values.shape
    above, here, below = values[max(row - 1, 0)], values[row], values[min(row + 1, rows - 1)]
    mean, rise = np.empty(_TILE + 2, np.float32), np.empty(_TILE + 2, np.float32)
    two, eighth = np.float32(2.0), np.float32(0.125)
    before, after = max(start - 1, 0), min(start + count, columns - 1)
    for k in range(3):
        for c in range(count):
            at = start + c
            mean[c + 1] = above[at, k] + two * here[at, k] + below[at, k]
            rise[c + 1] = below[at, k] - above[at, k]
        mean[0] = above[before, k] + two * here[before, k] + below[before, k]
        rise[0] = below[before, k] - above[before, k]
        mean[count + 1] = above[after, k] + two * here[after, k] + below[after, k]
        rise[count + 1] = below[after, k] - above[after, k]
        for c in range(count):
            tile[_ACROSS + k, c] = (mean[c + 2] - mean[c]) * eighth
            tile[_DOWN + k, c] = (rise[c] + two * rise[c + 1] + rise[c + 2]) * eighth


@njit(cache=True, error_model="numpy")
def _look_up(tile: Any, count: int, low: Any, step: Any, bin_of: Any, filled: Any) -> None:
    """Write the filled bin of each intensity; NaN gives the first bin."""
    bins = bin_of.shape[0]
    top, zero = np.float32(bins - 1), np.float32(0.0)
    for channel in range(3):
        scale = np.float32(1.0) / step[channel]
        for c in range(count):
            index = (tile[_COLOUR + channel, c] - low[channel]) * scale
            index = index if index > zero else zero
            index = index if index < top else top
            filled[c] = (filled[c] * bins if channel else 0) + np.int32(index)
    flat = bin_of.reshape(-1)
    for c in range(count):
        filled[c] = flat[filled[c]]


@njit(cache=True, error_model="numpy")
def _choose(tile: Any, c: int, first: int, end: int, candidates: Any, settings: Any) -> None:
    """Write the results of the candidate with the smallest ε² (paper, below eq. 8)."""
    least = np.float32(np.inf)
    for index in range(first, end):
        a = candidates[index]
        judged = judge_candidate(
            (a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8], a[9], a[10]),
            (tile[11, c], tile[12, c], tile[13, c]),
            (tile[14, c], tile[15, c], tile[16, c]),
            (tile[17, c], tile[18, c], tile[19, c]),
            settings,
        )
        if judged[3] < least:
            least = judged[3]
            tile[_RESULT, c], tile[_RESULT + 1, c], tile[_RESULT + 2, c] = judged[0], judged[1], judged[2]
