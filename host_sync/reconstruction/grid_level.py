"""One level of the grid: its edge weights and working arrays, and how the next coarser level follows from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numba import get_num_threads, njit, prange

from device.surface import Float32Array

SMALL_PX: Final = 1 << 16
"""Levels of fewer pixels are worked on by one thread: waking a second one takes longer."""

COARSEST_PX: Final = 64
"""A level of no more pixels is solved directly."""


@dataclass(frozen=True, slots=True, eq=False)
class GridLevel:
    """One level.

    shape : (H, W) of the level
    across : float32 array of shape (H, W + 1), weights of the edges left of each pixel; None where every edge weighs 1
    down : float32 array of shape (H + 1, W), weights of the edges above each pixel; None where every edge weighs 1
    z, spare : float32 arrays of shape (H, W), heights before and after a sweep, pixels
    rhs : float32 array of shape (H, W), right-hand side, pixels
    """

    shape: tuple[int, int]
    across: Float32Array | None
    down: Float32Array | None
    z: Float32Array = field(init=False)
    spare: Float32Array = field(init=False)
    rhs: Float32Array = field(init=False)

    def __post_init__(self) -> None:
        for name in ("z", "spare", "rhs"):
            object.__setattr__(self, name, np.empty(self.shape, np.float32))

    @property
    def bands(self) -> int:
        """Number of bands of rows that are worked on side by side; results do not depend on it."""
        rows, columns = self.shape
        return 1 if rows * columns < SMALL_PX else max(1, min(4 * get_num_threads(), rows // 32))


def finest_level(shape: tuple[int, int], weighted: bool) -> GridLevel:
    """The level of a field's own pixels; its weights are yet to be written."""
    rows, columns = shape
    if not weighted:
        return GridLevel(shape, None, None)
    return GridLevel(shape, np.empty((rows, columns + 1), np.float32), np.empty((rows + 1, columns), np.float32))


def coarser_levels(finest: GridLevel) -> list[GridLevel]:
    """All levels, the finest first, down to one that is small enough to be solved directly."""
    levels = [finest]
    while levels[-1].shape[0] * levels[-1].shape[1] > COARSEST_PX:
        levels.append(_coarser(levels[-1]))
    return levels


def _coarser(fine: GridLevel) -> GridLevel:
    """The next level: 2:1 with sizes rounded up; its edges weigh half the sum of the fine edges that they cross."""
    rows, columns = fine.shape
    shape = (rows + 1) // 2, (columns + 1) // 2
    even = rows % 2 == 0 and columns % 2 == 0
    if fine.across is None and even and shape[0] * shape[1] >= SMALL_PX:
        return GridLevel(shape, None, None)
    across, down = edge_weights(fine)
    coarse = finest_level(shape, weighted=True)
    bands = max(1, min(fine.bands, shape[0]))
    _coarsen(across, down, coarse.across, coarse.down, bands)
    return coarse


def edge_weights(level: GridLevel) -> tuple[Float32Array, Float32Array]:
    """Weights of the edges left of and above each pixel, ones written out where the level stores none."""
    if level.across is not None and level.down is not None:
        return level.across, level.down
    rows, columns = level.shape
    across, down = np.ones((rows, columns + 1), np.float32), np.ones((rows + 1, columns), np.float32)
    across[:, 0] = across[:, -1] = 0.0
    down[0] = down[-1] = 0.0
    return across, down


@njit(cache=True, parallel=True)
def _coarsen(across: Any, down: Any, coarse_across: Any, coarse_down: Any, bands: int) -> None:
    """Write the edge weights of the next level."""
    half, nought = np.float32(0.5), np.float32(0.0)
    rows, columns = across.shape[0], down.shape[1]
    coarse_rows, coarse_columns = coarse_across.shape[0], coarse_down.shape[1]
    for band in prange(bands):
        for r in range(band * coarse_rows // bands, (band + 1) * coarse_rows // bands):
            upper, lower, top = across[2 * r], across[min(2 * r + 1, rows - 1)], down[2 * r]
            share = half if 2 * r + 1 < rows else nought
            for c in range(coarse_columns):
                coarse_across[r, c] = half * upper[2 * c] + share * lower[2 * c]
            for c in range(columns // 2):
                coarse_down[r, c] = half * (top[2 * c] + top[2 * c + 1])
            if columns % 2:
                coarse_down[r, coarse_columns - 1] = half * top[columns - 1]
            coarse_across[r, coarse_columns] = nought
    coarse_down[coarse_rows] = nought
