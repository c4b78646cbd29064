"""One level of the grid: its edges and working arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float32Array

COARSEST_PX: Final = 16
"""A level with at most this many pixels is solved directly."""

TRANSFORM_PX: Final = 1 << 18
"""The same where every edge weighs 1."""


@dataclass(frozen=True, slots=True, eq=False)
class FineLevel:
    """The finest level, whose edges are built from pixels in every pass.

    p, q : float32 arrays of shape (H, W), slopes
    weight : float32 array of shape (H, W), 0 at holes; None where every pixel weighs 1
    scale : factor that makes the largest weight 1
    rule : `edge_coefficients`, times the pixel pitch for heights in its unit
    min_tolerance : smallest tolerance of heights
    """

    p: Float32Array
    q: Float32Array
    weight: Float32Array | None
    scale: np.float32
    rule: Float32Array
    min_tolerance: float


@dataclass(slots=True, eq=False)
class GridLevel:
    """A coarse level, or the finest with its edges stored.

    shape : (H, W) of the level
    weight_x, weight_y : float32 arrays of shapes (H, W + 1) and (H + 1, W), weights of the edges left of and above each
        pixel, 0 at both ends; None where every edge weighs 1
    slope_x, slope_y : float32 arrays of the same shapes, slopes of those edges, pixels of the level
    z : float32 array of shape (H, W), heights, pixels; with weights, prolongation offsets until heights are known
    spare : float32 array of shape (H, W), receives the heights of the next sweep
    rhs : float32 array of shape (H, W), right-hand side, pixels
    """

    shape: tuple[int, int]
    weight_x: Float32Array | None
    weight_y: Float32Array | None
    slope_x: Float32Array
    slope_y: Float32Array
    z: Float32Array
    spare: Float32Array
    rhs: Float32Array

    def swap(self) -> None:
        """Make what a sweep wrote to `spare` the heights."""
        self.z, self.spare = self.spare, self.z


def new_level(shape: tuple[int, int], weighted: bool) -> GridLevel:
    """A level with uninitialized arrays."""
    rows, columns = shape
    weight_x, weight_y = (rows, columns + 1), (rows + 1, columns)
    return GridLevel(
        shape,
        np.empty(weight_x, np.float32) if weighted else None,
        np.empty(weight_y, np.float32) if weighted else None,
        *(np.empty(size, np.float32) for size in (weight_x, weight_y, shape, shape, shape)),
    )


def coarser_levels(shape: tuple[int, int], weighted: bool) -> list[GridLevel]:
    """All coarse levels for a field of this shape, 2:1 with sizes rounded up, down to one that is solved directly.

    Without weights, cells at an odd end hold half as many edges: from there on levels have weights.
    """
    levels: list[GridLevel] = []
    direct_px = COARSEST_PX
    while shape[0] * shape[1] > direct_px:
        rows, columns = shape
        odd = rows % 2 == 1 or columns % 2 == 1
        shape = (rows + 1) // 2, (columns + 1) // 2
        level = new_level(shape, weighted)
        if odd and not weighted:
            _write_odd_weights(level, rows, columns)
        levels.append(level)
        weighted = weighted or odd
        direct_px = COARSEST_PX if weighted else TRANSFORM_PX
    return levels


def _write_odd_weights(level: GridLevel, rows: int, columns: int) -> None:
    """Set the weights of the level below one of (rows, columns) pixels without weights."""
    level.weight_x, level.weight_y = unit_weights(level.shape)
    if rows % 2:
        level.weight_x[-1] *= 0.5
    if columns % 2:
        level.weight_y[:, -1] *= 0.5


def edge_weights(level: GridLevel) -> tuple[Float32Array, Float32Array]:
    """Weights of the edges left of and above each pixel; ones where the level stores none."""
    if level.weight_x is not None and level.weight_y is not None:
        return level.weight_x, level.weight_y
    return unit_weights(level.shape)


def unit_weights(shape: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
    """Weights of a full rectangle's edges: 1 between pixels, 0 at the ends."""
    rows, columns = shape
    weight_x, weight_y = np.ones((rows, columns + 1), np.float32), np.ones((rows + 1, columns), np.float32)
    weight_x[:, 0] = weight_x[:, -1] = 0.0
    weight_y[0] = weight_y[-1] = 0.0
    return weight_x, weight_y
