"""From pixels of equal weight to the edges of the next coarser level.

Without weights the shapes of cells (`cell_shape`) drop out of coarse slopes. The two pixels on one side of a cell lie
together as far above it as those on the other side lie below, by half of the slopes E of the two edges between them, so
that what `condense` works out for any weights is

    G = E_c / 2 + (E_(c-1) + E_(c+1)) / 4,

E being sums over the two rows (or columns) of a cell. Edges are linear in slopes: pixels are added first, and edges
made of half as many numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from host_sync.reconstruction.edge_slopes import across_edges, unit_edge_slopes
from host_sync.reconstruction.grid_level import GridLevel, PixelField
from host_sync.reconstruction.level_rows import ring
from host_sync.reconstruction.pixel_pairs import first_of, second_of
from host_sync.reconstruction.row_bands import in_bands
from host_sync.reconstruction.smoother import CONTRACT
from host_sync.reconstruction.transfer import restrict_row

SUMS, EDGES = 8, 4
"""Rows at hand: of sums that an edge row may need, and of edges that a coarse row does."""


def condense_unit_pixels(field: PixelField, coarse: GridLevel) -> None:
    """Write the slopes of the edges of the level below pixels that weigh the same."""
    in_bands(_condense_pixels, field.p.shape, field.p, field.q, field.rule, coarse.slope_across, coarse.slope_down)


def condense_unit_level(level: GridLevel, coarse: GridLevel) -> None:
    """Write the slopes of the edges of the level below one whose edges weigh the same."""
    in_bands(_condense_edges, level.shape, level.slope_across, level.slope_down, coarse.slope_across, coarse.slope_down)


@njit(cache=True, nogil=True)
def _condense_pixels(p: Any, q: Any, rule: Any, across: Any, down: Any, begin: int, end: int) -> None:
    """Work on the cells of the fine rows `begin` (even) to `end` - 1."""
    rows, columns = p.shape
    first, last = begin // 2, (end + 1) // 2
    both, between = ring(1, columns)[0], ring(1, columns + 1)[0]
    sums, edges = ring(SUMS, down.shape[1]), ring(EDGES, down.shape[1])
    known, edge = max(2 * first - 3, 0), 2 * first - 1
    for r in range(first, last):
        _add_rows(p[2 * r], p[min(2 * r + 1, rows - 1)], both)
        across_edges(both, rule, None, None, between)
        _write_across(between, across[r])
        for row in range(known, min(2 * r + 3, rows)):
            _add_pairs(q[row], sums[row % SUMS])
        for row in range(edge, 2 * r + 2):
            _down_edges(sums, row, rows, rule, edges[row % EDGES])
        known, edge = min(2 * r + 3, rows), 2 * r + 2
        _write_down(edges[(2 * r - 1) % EDGES], edges[2 * r % EDGES], edges[(2 * r + 1) % EDGES], down[r])
        if r == 0:
            down[0, :] = 0.0
    if last == across.shape[0]:
        down[last, :] = 0.0


@njit(cache=True, nogil=True)
def _condense_edges(fine_across: Any, fine_down: Any, across: Any, down: Any, begin: int, end: int) -> None:
    """Work on the cells of the fine rows `begin` (even) to `end` - 1."""
    rows, columns = fine_across.shape[0], fine_down.shape[1]
    first, last = begin // 2, (end + 1) // 2
    both, edges = ring(1, columns + 1)[0], ring(EDGES, down.shape[1])
    for r in range(first, last):
        _add_rows(fine_across[2 * r], fine_across[min(2 * r + 1, rows - 1)], both)
        _write_across(both, across[r])
        for row in range(2 * r - 1 if r == first else 2 * r, min(2 * r + 2, rows + 1)):
            _add_pairs(fine_down[max(row, 0)], edges[row % EDGES])
        _write_down(edges[(2 * r - 1) % EDGES], edges[2 * r % EDGES], edges[(2 * r + 1) % EDGES], down[r])
        if r == 0:
            down[0, :] = 0.0
    if last == across.shape[0]:
        down[last, :] = 0.0


@njit(cache=True)
def _add_rows(upper: Any, lower: Any, out: Any) -> None:
    """Write the sums of a cell's two rows; a single last row comes as both."""
    for c in range(out.size):
        out[c] = upper[c] + lower[c]


@njit(cache=True)
def _add_pairs(row: Any, out: Any) -> None:
    """Write the sums of a row's cells; a single last column counts twice."""
    restrict_row(row, False, out)
    if row.size % 2:
        out[out.size - 1] += out[out.size - 1]


@njit(cache=True)
def _down_edges(sums: Any, row: int, rows: int, rule: Any, out: Any) -> None:
    """Write the slopes of the edges above `row`, nought above the first and below the last row."""
    if row <= 0 or row >= rows:
        out[:] = 0.0
        return
    a, b = row - 1, row
    if row == 1 or row == rows - 1:
        rule = np.array([rule[0], rule[1], np.float32(0.0)], np.float32)
    o, e = max(row - 2, 0), min(row + 1, rows - 1)
    unit_edge_slopes(sums[o % SUMS], sums[a % SUMS], sums[b % SUMS], sums[e % SUMS], rule, out)


@njit(cache=True, fastmath=CONTRACT)
def _write_across(edges: Any, out: Any) -> None:
    """Write the slopes of the edges left of a row of cells."""
    half, quarter = np.float32(0.5), np.float32(0.25)
    for i in range(1, out.size - 1):
        out[i] = half * first_of(edges, i) + quarter * (second_of(edges, i - 1) + second_of(edges, i))
    out[0], out[out.size - 1] = np.float32(0.0), np.float32(0.0)


@njit(cache=True, fastmath=CONTRACT)
def _write_down(before: Any, edges: Any, after: Any, out: Any) -> None:
    """Write the slopes of the edges above a row of cells."""
    half, quarter = np.float32(0.5), np.float32(0.25)
    for i in range(out.size):
        out[i] = half * edges[i] + quarter * (before[i] + after[i])
