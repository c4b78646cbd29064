"""One level of the grid: its edges and working arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from device.surface import Float32Array
from host_sync.integration.smoother import CONTRACT
from host_sync.kernels.jit import njit

# Weights and slopes of the edges between neighbouring pixels, built row by row from slopes and weights of the pixels.
#
# An edge joins pixels a and b in line. The two-point mean (g_a + g_b) / 2 has variance (v_a + v_b) / 4, so with weights
# w = 1 / v the edge's weight is the harmonic mean w_e = 2 w_a w_b / (w_a + w_b) (up to a common factor).
#
# Rules for the edge's height difference, in pixels (g_o and g_p lie beyond a and b):
#
# * fourth-order: 13/24 (g_a + g_b) - 1/24 (g_o + g_p). The mean of a cubic over [0, 1] from its values at -1, 0, 1, 2:
#   even parts 1 and (x - 1/2)² give α + β = 1/2 and α/4 + 9β/4 = 1/24, so β = -1/24, α = 13/24; odd parts cancel. The
#   two-point mean where g_o or g_p is missing, or so uncertain that it would dominate the edge's variance.
# * two-point: (g_a + g_b) / 2.
# * printed: g_a, the one-sided difference of the paper's eq. 10, for comparison.
#
# Loops over pairs of pixels read both pixels of each pair (`first_of`, `second_of`): the compiler loads whole pairs as
# vectors, which is several times as fast as gathering every second number. It may not drop the product with zero,
# because the other factor could be infinite; here both are finite, so the product adds nothing.

EdgeRule = Literal["fourth-order", "two-point", "printed"]

MIN_OUTER: Final = np.float32(0.01)
"""Outer pixels below this weight, relative to the edge, are ignored; above it they add at most 1/3 to the variance."""

TINY: Final = np.float32(1e-30)
"""Keeps 0 / 0 finite."""

_COEFFICIENTS: Final = {
    "fourth-order": (0.5, 0.5, 1.0 / 24.0),
    "two-point": (0.5, 0.5, 0.0),
    "printed": (1.0, 0.0, 0.0),
}


def edge_coefficients(rule: EdgeRule) -> Float32Array:
    """Return coefficients (α, β, γ) of α g_a + β g_b + γ ((g_a + g_b) - (g_o + g_p)), float32."""
    return np.asarray(_COEFFICIENTS[rule], np.float32)


@njit(cache=True, error_model="numpy")
def _edge_weight(w_a: Any, w_b: Any) -> Any:
    """Return the harmonic mean of two non-negative weights, 0 where either is a hole."""
    return np.float32(2.0) * w_a * (w_b / max(w_a + w_b, TINY))


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def weighted_edges(
    g_o: Any, g_a: Any, g_b: Any, g_p: Any, w_o: Any, w_a: Any, w_b: Any, w_p: Any, rule: Any, weight: Any, slope: Any
) -> None:
    """Write weights and slopes of a row of edges, 0 where the edge has no weight."""
    alpha, beta, gamma, zero = rule[0], rule[1], rule[2], np.float32(0.0)
    for i in range(slope.size):
        w = _edge_weight(w_a[i], w_b[i])
        bend = gamma * ((g_a[i] + g_b[i]) - (g_o[i] + g_p[i]))
        bent = bend if min(w_o[i], w_p[i]) > MIN_OUTER * w else zero
        slope[i] = alpha * g_a[i] + beta * g_b[i] + bent if w > zero else zero
        weight[i] = w


@njit(cache=True, fastmath=CONTRACT)
def unit_edge_slopes(g_o: Any, g_a: Any, g_b: Any, g_p: Any, rule: Any, slope: Any) -> None:
    """Write the slopes of a row of edges where every pixel weighs 1."""
    alpha, beta, gamma = rule[0], rule[1], rule[2]
    for i in range(slope.size):
        bend = gamma * ((g_a[i] + g_b[i]) - (g_o[i] + g_p[i]))
        slope[i] = alpha * g_a[i] + beta * g_b[i] + bend


@njit(cache=True)
def weight_row(weight: Any, scale: Any, row: int, out: Any) -> None:
    """Write a row of pixel weights times `scale` with two pixels of padding at each end, 0 there and outside the field.

    weight : float32 array of shape (H, W), 0 or NaN at holes
    """
    zero = np.float32(0.0)
    if 0 <= row < weight.shape[0]:
        source = weight[row]
        for c in range(source.size):
            out[c + 2] = source[c] * scale if source[c] > zero else zero
    else:
        for c in range(out.size):
            out[c] = zero


@njit(cache=True)
def x_edges(p: Any, rule: Any, pixels: Any, weight: Any, slope: Any) -> None:
    """Write weights and slopes of the edges left of a row's pixels, 0 at both ends.

    p : row of slopes, float32 array of shape (W,)
    pixels : padded row of pixel weights; None where every pixel weighs 1
    weight, slope : float32 arrays of shape (W + 1,); `weight` is None where every pixel weighs 1
    """
    last, zero = p.size, np.float32(0.0)
    if pixels is None:
        unit_edge_slopes(p[0 : last - 3], p[1 : last - 2], p[2 : last - 1], p[3:last], rule, slope[2 : last - 1])
        for c in (1, last - 1):
            slope[c] = rule[0] * p[c - 1] + rule[1] * p[c]
        slope[0], slope[last] = zero, zero
        return
    n = last - 3
    weighted_edges(
        p[0:n], p[1 : n + 1], p[2 : n + 2], p[3 : n + 3],
        pixels[2 : n + 2], pixels[3 : n + 3], pixels[4 : n + 4], pixels[5 : n + 5], rule, weight[2:last], slope[2:last],
    )  # fmt: skip
    for c in (1, last - 1):
        weight[c] = _edge_weight(pixels[c + 1], pixels[c + 2])
        slope[c] = rule[0] * p[c - 1] + rule[1] * p[c] if weight[c] > zero else zero
    weight[0], weight[last], slope[0], slope[last] = zero, zero, zero, zero


@njit(cache=True)
def y_edges(q: Any, rule: Any, row: int, pixels: Any, weight: Any, slope: Any) -> None:
    """Write weights and slopes of the edges above the pixels of `row`, 0 above the first and below the last row.

    q : float32 array of shape (H, W)
    pixels : padded rows of pixel weights, row r at index r mod 4; None where every pixel weighs 1
    weight, slope : float32 arrays of shape (W,); `weight` is None where every pixel weighs 1
    """
    rows, zero = q.shape[0], np.float32(0.0)
    if row == 0 or row == rows:
        for c in range(slope.size):
            slope[c] = zero
        if weight is not None:
            for c in range(slope.size):
                weight[c] = zero
        return
    o, a, b, e = max(row - 2, 0), row - 1, row, min(row + 1, rows - 1)
    if pixels is None:
        if o == a or e == b:
            rule = np.array([rule[0], rule[1], zero], np.float32)
        unit_edge_slopes(q[o], q[a], q[b], q[e], rule, slope)
    else:
        inner = slice(2, slope.size + 2)
        beyond, near = pixels[(row - 2) % 4][inner], pixels[(row - 1) % 4][inner]
        here, far = pixels[row % 4][inner], pixels[(row + 1) % 4][inner]
        weighted_edges(q[o], q[a], q[b], q[e], beyond, near, here, far, rule, weight, slope)


ZERO: Final = np.float32(0.0)


@njit(inline="always")
def first_of(row: Any, pair: int) -> Any:
    """Return the first pixel of a pair; both must be finite."""
    return row[2 * pair] + ZERO * row[2 * pair + 1]


@njit(inline="always")
def second_of(row: Any, pair: int) -> Any:
    """Return the second pixel of a pair; both must be finite."""
    return row[2 * pair + 1] + ZERO * row[2 * pair]


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
    """Return a level with uninitialized arrays."""
    rows, columns = shape
    weight_x, weight_y = (rows, columns + 1), (rows + 1, columns)
    return GridLevel(
        shape,
        np.empty(weight_x, np.float32) if weighted else None,
        np.empty(weight_y, np.float32) if weighted else None,
        *(np.empty(size, np.float32) for size in (weight_x, weight_y, shape, shape, shape)),
    )


def coarser_levels(shape: tuple[int, int], weighted: bool) -> list[GridLevel]:
    """Return all coarse levels for a field of this shape, down to one that is solved directly.

    Sizes are halved and rounded up. Without weights, cells at an odd end hold half as many edges: from there on levels
    have weights.
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
    """Return weights of the edges left of and above each pixel; ones where the level stores none."""
    if level.weight_x is not None and level.weight_y is not None:
        return level.weight_x, level.weight_y
    return unit_weights(level.shape)


def unit_weights(shape: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
    """Return weights of a full rectangle's edges: 1 between pixels, 0 at the ends."""
    rows, columns = shape
    weight_x, weight_y = np.ones((rows, columns + 1), np.float32), np.ones((rows + 1, columns), np.float32)
    weight_x[:, 0] = weight_x[:, -1] = 0.0
    weight_y[0] = weight_y[-1] = 0.0
    return weight_x, weight_y
