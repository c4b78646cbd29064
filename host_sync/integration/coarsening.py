"""Edges of the next coarser level: the first half of full multigrid.

With weights, coarse edges take the weights and slopes of `matrix_free_rows`. Slopes are passed down, not their
divergence, so that each level's least-squares solution is the surface itself.

Without weights the offsets drop out. The two pixels on one side of a cell lie as far above it as those on the other
side lie below, by half the slopes E of the two edges between them, which leaves

    G = E_c / 2 + (E_(c-1) + E_(c+1)) / 4

with E summed over the two rows (or columns) of a cell. Edges are linear in slopes, so pixels are summed first and half
as many edges are built.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from host_sync.integration.levels import FineLevel, GridLevel, first_of, second_of, unit_edge_slopes, x_edges
from host_sync.integration.matrix_free_rows import (
    advance_edges,
    begin_edges,
    coarse_x_edges,
    coarse_y_edges,
    offset_rows,
    ring,
    system_row,
)
from host_sync.integration.smoother import CONTRACT
from host_sync.integration.transfer import restrict_row
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

RING: Final = 4
"""Rows of edges that one coarse row needs: those of the cell, above it and below it."""

SUMS, EDGES = 8, 4
"""Rows kept without weights: sums that a row of edges needs, and edges that a coarse row needs."""


class Coarse(NamedTuple):
    """Arrays that the weighted kernel writes, and its constants.

    weight_x, slope_x, weight_y, slope_y : arrays of the coarse level, as in `GridLevel`
    damping : as in `conductance`, float32
    rows, columns : of the fine level
    """

    weight_x: Any
    slope_x: Any
    weight_y: Any
    slope_y: Any
    damping: Any
    rows: int
    columns: int


def coarsen_pixels(field: FineLevel, coarse: GridLevel, damping: float) -> None:
    """Write the edges of the first coarse level; `damping` as in `conductance`."""
    if field.weight is None:
        arguments = (field.p, field.q, field.rule, coarse.slope_x, coarse.slope_y)
        parallel_rows(_coarsen_unit_pixels, field.p.shape, *arguments)
        return
    target = _coarse(coarse, damping, field.p.shape)
    source = (field.p, field.q, field.weight, field.scale, field.rule, *(None,) * 6)
    parallel_rows(_coarsen_rows, field.p.shape, *source, target)


def coarsen(level: GridLevel, coarse: GridLevel, damping: float) -> None:
    """Write the edges of `coarse`; with weights, also the right-hand side of `level` and, in its `z`, the offsets."""
    if level.weight_x is None:
        arguments = (level.slope_x, level.slope_y, coarse.slope_x, coarse.slope_y)
        parallel_rows(_coarsen_unit_edges, level.shape, *arguments)
        return
    source = (*(None,) * 5, level.weight_x, level.slope_x, level.weight_y, level.slope_y, level.rhs, level.z)
    parallel_rows(_coarsen_rows, level.shape, *source, _coarse(coarse, damping, level.shape))


def _coarse(level: GridLevel, damping: float, shape: tuple[int, ...]) -> Coarse:
    arrays = level.weight_x, level.slope_x, level.weight_y, level.slope_y
    return Coarse(*arrays, np.float32(damping), shape[0], shape[1])


@njit(cache=True, nogil=True)
def _coarsen_rows(
    p: Any, q: Any, weight: Any, scale: Any, rule: Any, weight_x: Any, slope_x: Any, weight_y: Any, slope_y: Any,
    rhs: Any, fine_offsets: Any, coarse: Any, begin: int, end: int,
) -> None:  # fmt: skip
    """Coarsen the fine rows `begin` (even) to `end` - 1.

    p, q, weight, scale, rule : as in `FineLevel`; None where the level's edges are stored
    weight_x, slope_x, weight_y, slope_y, rhs, fine_offsets : as in `GridLevel`; None where edges are built from pixels
    coarse : `Coarse`
    """
    first, last, rows, columns = begin // 2, (end + 1) // 2, coarse.rows, coarse.columns
    nothing = ring(1, columns + 1)[0]
    offsets = ring(4, columns)
    start = max(first - 1, 0)
    pixels = None if p is None else ring(4, columns + 4)
    if p is not None:
        slope_x, slope_y = ring(RING, columns + 1), ring(RING, columns)
        weight_x, weight_y = ring(RING, columns + 1), ring(RING, columns)
        begin_edges(q, weight, scale, rule, 2 * start, pixels, weight_y, slope_y)
    for r in range(start, last):
        if p is not None:
            for row in range(2 * r, min(2 * r + 2, rows)):
                advance_edges(p, q, weight, scale, rule, row, pixels, weight_x, slope_x, weight_y, slope_y)
        upper, lower = offsets[2 * (r % 2)], offsets[2 * (r % 2) + 1]
        offset_rows(2 * r, rows, weight_x, slope_x, weight_y, slope_y, nothing, nothing, upper, lower)
        if r < first:
            continue
        above = offsets[2 * ((r + 1) % 2) + 1]
        _coarse_row(r, weight_x, slope_x, weight_y, slope_y, nothing, above, upper, lower, coarse)
        if rhs is not None:
            for row in range(2 * r, min(2 * r + 2, rows)):
                system_row(row, weight_x, slope_x, weight_y, slope_y, rhs, None)
                offset = upper if row % 2 == 0 else lower
                for c in range(columns):
                    fine_offsets[row, c] = offset[c]
    if last == coarse.slope_x.shape[0]:
        coarse.slope_y[last, :], coarse.weight_y[last, :] = 0.0, 0.0


@njit(cache=True)
def _coarse_row(
    r: int, weight_x: Any, slope_x: Any, weight_y: Any, slope_y: Any, nothing: Any, above: Any, upper: Any, lower: Any,
    coarse: Any,
) -> None:  # fmt: skip
    """Write the edges left of and above coarse row `r`, from the offsets of its rows and of the row `above` them."""
    a, b = 2 * r % slope_x.shape[0], (2 * r + 1) % slope_x.shape[0]
    n = slope_y.shape[0]
    t, m, d = (2 * r - 1) % n, 2 * r % n, (2 * r + 1) % n
    out_weight, out_slope = coarse.weight_x[r], coarse.slope_x[r]
    if 2 * r + 1 == coarse.rows:
        coarse_x_edges(
            slope_x[a], nothing, weight_x[a], nothing, upper, upper, coarse.damping, out_weight, out_slope
        )  # fmt: skip
    else:
        coarse_x_edges(
            slope_x[a], slope_x[b], weight_x[a], weight_x[b], upper, lower, coarse.damping, out_weight, out_slope
        )  # fmt: skip
    out_weight, out_slope = coarse.weight_y[r], coarse.slope_y[r]
    if r == 0:
        out_slope[:], out_weight[:] = 0.0, 0.0
    else:
        coarse_y_edges(
            slope_y[m], weight_y[t], weight_y[m], weight_y[d], above, upper, coarse.damping, out_weight, out_slope
        )  # fmt: skip


@njit(cache=True, nogil=True)
def _coarsen_unit_pixels(p: Any, q: Any, rule: Any, slope_x: Any, slope_y: Any, begin: int, end: int) -> None:
    """Write slopes built from pixels of equal weight, for the cells of the fine rows `begin` (even) to `end` - 1."""
    rows, columns = p.shape
    first, last = begin // 2, (end + 1) // 2
    both, between = ring(1, columns)[0], ring(1, columns + 1)[0]
    sums, edges = ring(SUMS, slope_y.shape[1]), ring(EDGES, slope_y.shape[1])
    known, edge = max(2 * first - 3, 0), 2 * first - 1
    for r in range(first, last):
        _add_rows(p[2 * r], p[min(2 * r + 1, rows - 1)], both)
        x_edges(both, rule, None, None, between)
        _write_x(between, slope_x[r])
        for row in range(known, min(2 * r + 3, rows)):
            _add_pairs(q[row], sums[row % SUMS])
        for row in range(edge, 2 * r + 2):
            _y_edges(sums, row, rows, rule, edges[row % EDGES])
        known, edge = min(2 * r + 3, rows), 2 * r + 2
        _write_y(edges[(2 * r - 1) % EDGES], edges[2 * r % EDGES], edges[(2 * r + 1) % EDGES], slope_y[r])
        if r == 0:
            slope_y[0, :] = 0.0
    if last == slope_x.shape[0]:
        slope_y[last, :] = 0.0


@njit(cache=True, nogil=True)
def _coarsen_unit_edges(fine_x: Any, fine_y: Any, slope_x: Any, slope_y: Any, begin: int, end: int) -> None:
    """Write slopes built from edges of weight 1, for the cells of the fine rows `begin` (even) to `end` - 1."""
    rows, columns = fine_x.shape[0], fine_y.shape[1]
    first, last = begin // 2, (end + 1) // 2
    both, edges = ring(1, columns + 1)[0], ring(EDGES, slope_y.shape[1])
    for r in range(first, last):
        _add_rows(fine_x[2 * r], fine_x[min(2 * r + 1, rows - 1)], both)
        _write_x(both, slope_x[r])
        for row in range(2 * r - 1 if r == first else 2 * r, min(2 * r + 2, rows + 1)):
            _add_pairs(fine_y[max(row, 0)], edges[row % EDGES])
        _write_y(edges[(2 * r - 1) % EDGES], edges[2 * r % EDGES], edges[(2 * r + 1) % EDGES], slope_y[r])
        if r == 0:
            slope_y[0, :] = 0.0
    if last == slope_x.shape[0]:
        slope_y[last, :] = 0.0


@njit(cache=True)
def _add_rows(upper: Any, lower: Any, out: Any) -> None:
    """Write the sum of a cell's two rows; a single last row is passed as both."""
    for c in range(out.size):
        out[c] = upper[c] + lower[c]


@njit(cache=True)
def _add_pairs(row: Any, out: Any) -> None:
    """Write the sums of a row's cells; a single last column counts twice."""
    restrict_row(row, False, out)
    if row.size % 2:
        out[out.size - 1] += out[out.size - 1]


@njit(cache=True)
def _y_edges(sums: Any, row: int, rows: int, rule: Any, out: Any) -> None:
    """Write the slopes of the edges above `row`; zero above the first and below the last row."""
    if row <= 0 or row >= rows:
        out[:] = 0.0
        return
    a, b = row - 1, row
    if row == 1 or row == rows - 1:
        rule = np.array([rule[0], rule[1], np.float32(0.0)], np.float32)
    o, e = max(row - 2, 0), min(row + 1, rows - 1)
    unit_edge_slopes(sums[o % SUMS], sums[a % SUMS], sums[b % SUMS], sums[e % SUMS], rule, out)


@njit(cache=True, fastmath=CONTRACT)
def _write_x(edges: Any, out: Any) -> None:
    """Write the slopes of the edges left of a row of cells."""
    half, quarter = np.float32(0.5), np.float32(0.25)
    for i in range(1, out.size - 1):
        out[i] = half * first_of(edges, i) + quarter * (second_of(edges, i - 1) + second_of(edges, i))
    out[0], out[out.size - 1] = np.float32(0.0), np.float32(0.0)


@njit(cache=True, fastmath=CONTRACT)
def _write_y(before: Any, edges: Any, after: Any, out: Any) -> None:
    """Write the slopes of the edges above a row of cells."""
    half, quarter = np.float32(0.5), np.float32(0.25)
    for i in range(out.size):
        out[i] = half * edges[i] + quarter * (before[i] + after[i])
