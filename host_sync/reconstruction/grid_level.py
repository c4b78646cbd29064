"""One level of the grid: its edges and working arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface import Float32Array

COARSEST_PX: Final = 16
"""A level of no more pixels is solved directly."""

TRANSFORM_PX: Final = 1 << 18
"""The same where every edge weighs 1."""


@dataclass(frozen=True, slots=True, eq=False)
class PixelField:
    """What the edges of the finest level are made from, pass by pass.

    p, q : float32 arrays of shape (H, W), slopes
    weight : float32 array of shape (H, W), nought at holes; None where every pixel weighs 1
    scale : factor of the weights that brings the largest to 1
    rule : `edge_coefficients`, times the pixel's pitch where heights are to have its unit
    least_tolerance : least error of heights that is worth asking for
    """

    p: Float32Array
    q: Float32Array
    weight: Float32Array | None
    scale: np.float32
    rule: Float32Array
    least_tolerance: float


@dataclass(slots=True, eq=False)
class GridLevel:
    """One level, coarser than the pixels or with the pixels' edges written out.

    shape : (H, W) of the level
    across, down : float32 arrays of shapes (H, W + 1) and (H + 1, W), weights of the edges left of and above each
        pixel, nought at both ends; None where every edge weighs 1
    slope_across, slope_down : float32 arrays of the same shapes, slopes of those edges, pixels of the level
    z : float32 array of shape (H, W), heights, pixels (before they are known, with weights, the shapes of the cells)
    spare : float32 array of shape (H, W), receives the heights of the next sweep
    rhs : float32 array of shape (H, W), right-hand side, pixels
    """

    shape: tuple[int, int]
    across: Float32Array | None
    down: Float32Array | None
    slope_across: Float32Array
    slope_down: Float32Array
    z: Float32Array
    spare: Float32Array
    rhs: Float32Array

    def swap(self) -> None:
        """Take what a sweep wrote to `spare` for the heights."""
        self.z, self.spare = self.spare, self.z


def new_level(shape: tuple[int, int], weighted: bool) -> GridLevel:
    """A level with its arrays yet to be written."""
    rows, columns = shape
    across, down = (rows, columns + 1), (rows + 1, columns)
    return GridLevel(
        shape,
        np.empty(across, np.float32) if weighted else None,
        np.empty(down, np.float32) if weighted else None,
        *(np.empty(size, np.float32) for size in (across, down, shape, shape, shape)),
    )


def coarser_levels(shape: tuple[int, int], weighted: bool) -> list[GridLevel]:
    """All levels below one of this shape, 2:1 with sizes rounded up, down to one small enough to be solved at once.

    Without weights, cells at an odd end hold half as many edges: from there on levels have weights.
    """
    levels: list[GridLevel] = []
    largest = COARSEST_PX
    while shape[0] * shape[1] > largest:
        rows, columns = shape
        odd = rows % 2 == 1 or columns % 2 == 1
        shape = (rows + 1) // 2, (columns + 1) // 2
        level = new_level(shape, weighted)
        if odd and not weighted:
            _write_odd_weights(level, rows, columns)
        levels.append(level)
        weighted = weighted or odd
        largest = COARSEST_PX if weighted else TRANSFORM_PX
    return levels


def _write_odd_weights(level: GridLevel, rows: int, columns: int) -> None:
    """Give the level below one of (rows, columns) pixels without weights those of its cells."""
    level.across, level.down = unit_weights(level.shape)
    if rows % 2:
        level.across[-1] *= 0.5
    if columns % 2:
        level.down[:, -1] *= 0.5


def edge_weights(level: GridLevel) -> tuple[Float32Array, Float32Array]:
    """Weights of the edges left of and above each pixel, ones written out where the level stores none."""
    if level.across is not None and level.down is not None:
        return level.across, level.down
    return unit_weights(level.shape)


def unit_weights(shape: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
    """Weights of a full rectangle's edges: 1 between pixels, nought at the ends."""
    rows, columns = shape
    across, down = np.ones((rows, columns + 1), np.float32), np.ones((rows + 1, columns), np.float32)
    across[:, 0] = across[:, -1] = 0.0
    down[0] = down[-1] = 0.0
    return across, down
