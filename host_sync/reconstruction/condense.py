"""From a level's edges to those of the next coarser level: the first half of full multigrid.

Coarse edges take the weights and slopes that `cell_shape` gives them. Slopes go down the levels, not their divergence,
so that each level's least squares have the surface itself as their solution.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

from host_sync.reconstruction.cell_shape import slopes_across, slopes_down
from host_sync.reconstruction.condense_unit import condense_unit_level, condense_unit_pixels
from host_sync.reconstruction.grid_level import GridLevel, PixelField
from host_sync.reconstruction.level_rows import first_edges, next_edges, ring, shape_rows, system_row
from host_sync.reconstruction.row_bands import in_bands

RING: Final = 4
"""Rows of edges at hand: those of a cell, those above it and those below; more would only crowd the cache."""


def condense_pixels(field: PixelField, coarse: GridLevel, apart: float) -> None:
    """Write the edges of the level below the pixels; `apart` as `conductance` takes it."""
    if field.weight is None:
        condense_unit_pixels(field, coarse)
        return
    nothing = (None, None, None, None, None, None)
    arguments = (
        field.p,
        field.q,
        field.weight,
        field.scale,
        field.rule,
        *nothing,
        *_edges(coarse),
        np.float32(apart),
        *field.p.shape,
    )
    in_bands(_condense, field.p.shape, *arguments)


def condense(level: GridLevel, coarse: GridLevel, apart: float) -> None:
    """Write the edges of `coarse`; where `level` has weights, also its right-hand side and, in its `z`, the shapes."""
    if level.across is None:
        condense_unit_level(level, coarse)
        return
    nothing = (None, None, None, None, None)
    arguments = (*nothing, *_edges(level), level.rhs, level.z, *_edges(coarse), np.float32(apart), *level.shape)
    in_bands(_condense, level.shape, *arguments)


def _edges(level: GridLevel) -> tuple[Any, ...]:
    return level.across, level.slope_across, level.down, level.slope_down


@njit(cache=True, nogil=True)
def _condense(
    p: Any, q: Any, weight: Any, scale: Any, rule: Any, across: Any, slope_across: Any, down: Any, slope_down: Any,
    rhs: Any, shapes: Any, w_across: Any, g_across: Any, w_down: Any, g_down: Any, apart: Any,
    rows: int, columns: int, begin: int, end: int,
) -> None:  # fmt: skip
    """Work on the cells of the fine rows `begin` (even) to `end` - 1."""
    first, last = begin // 2, (end + 1) // 2
    nothing = ring(1, columns + 1)[0]
    offsets = ring(4, columns)
    start = max(first - 1, 0)
    pixels = None if p is None else ring(4, columns + 4)
    if p is not None:
        slope_across, slope_down = ring(RING, columns + 1), ring(RING, columns)
        across, down = ring(RING, columns + 1), ring(RING, columns)
        first_edges(q, weight, scale, rule, 2 * start, pixels, down, slope_down)
    for r in range(start, last):
        if p is not None:
            for row in range(2 * r, min(2 * r + 2, rows)):
                next_edges(p, q, weight, scale, rule, row, pixels, across, slope_across, down, slope_down)
        upper, lower = offsets[2 * (r % 2)], offsets[2 * (r % 2) + 1]
        shape_rows(2 * r, rows, across, slope_across, down, slope_down, nothing, nothing, upper, lower)
        if r < first:
            continue
        above = offsets[2 * ((r + 1) % 2) + 1]
        _coarse_row(
            r, rows, across, slope_across, down, slope_down, nothing, above, upper, lower, w_across, g_across,
            w_down, g_down, apart,
        )  # fmt: skip
        if rhs is not None:
            for row in range(2 * r, min(2 * r + 2, rows)):
                system_row(row, across, slope_across, down, slope_down, rhs, None)
                shape = upper if row % 2 == 0 else lower
                for c in range(columns):
                    shapes[row, c] = shape[c]
    if last == g_across.shape[0]:
        g_down[last, :], w_down[last, :] = 0.0, 0.0


@njit(cache=True)
def _coarse_row(
    r: int, rows: int, across: Any, slope_across: Any, down: Any, slope_down: Any, nothing: Any, above: Any,
    upper: Any, lower: Any, w_across: Any, g_across: Any, w_down: Any, g_down: Any, apart: Any,
) -> None:  # fmt: skip
    """Write the edges left of and above the coarse row `r`, from the offsets of its rows and the one `above` them."""
    a, b = 2 * r % slope_across.shape[0], (2 * r + 1) % slope_across.shape[0]
    n = slope_down.shape[0]
    t, m, d = (2 * r - 1) % n, 2 * r % n, (2 * r + 1) % n
    single = 2 * r + 1 == rows
    if single:
        slopes_across(slope_across[a], nothing, across[a], nothing, upper, upper, apart, w_across[r], g_across[r])
    else:
        slopes_across(
            slope_across[a], slope_across[b], across[a], across[b], upper, lower, apart, w_across[r], g_across[r]
        )
    if r == 0:
        g_down[0, :], w_down[0, :] = 0.0, 0.0
    else:
        slopes_down(slope_down[m], down[t], down[m], down[d], above, upper, apart, w_down[r], g_down[r])
