"""Rows of a level as the passes over it need them: read where they are stored, else made from the pixels' slopes.

The finest level is large and its edges are cheap to work out, so that nothing of it is stored: each pass makes them
anew from p, q and the weights, into arrays that hold only the last few rows (rings). Row r stands at r mod the number
of rows of its array, which for a stored level is r itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from host_sync.reconstruction.cell_shape import unit_shape, weighted_shape
from host_sync.reconstruction.edge_slopes import across_edges, down_edges, weight_row
from host_sync.reconstruction.grid_level import GridLevel, PixelField, new_level
from host_sync.reconstruction.smoother import CONTRACT, inverse_diagonal, system_and_diagonal


def written_level(field: PixelField) -> GridLevel:
    """The pixels' own level with all its edges and its right-hand side written out."""
    level = new_level((field.p.shape[0], field.p.shape[1]), field.weight is not None)
    _write_edges(
        field.p, field.q, field.weight, field.scale, field.rule, level.across, level.slope_across, level.down,
        level.slope_down, level.rhs,
    )  # fmt: skip
    return level


@njit(cache=True)
def _write_edges(
    p: Any, q: Any, weight: Any, scale: Any, rule: Any, across: Any, slope_across: Any, down: Any, slope_down: Any,
    rhs: Any,
) -> None:  # fmt: skip
    """Write all edges and the right-hand side, row after row."""
    rows, columns = p.shape
    pixels = None if weight is None else ring(4, columns + 4)
    first_edges(q, weight, scale, rule, 0, pixels, down, slope_down)
    for r in range(rows):
        next_edges(p, q, weight, scale, rule, r, pixels, across, slope_across, down, slope_down)
        system_row(r, across, slope_across, down, slope_down, rhs, None)


@njit(cache=True)
def first_edges(
    q: Any, weight: Any, scale: Any, rule: Any, row: int, pixels: Any, down: Any, slope_down: Any
) -> None:  # fmt: skip
    """Make the edges above `row`, where a pass begins.

    q, weight : float32 arrays of shape (H, W); `weight` is None where every pixel weighs 1, else nought at holes
    scale : factor of the weights
    rule : `edge_coefficients`
    pixels : ring of 4 padded rows of pixel weights; None where every pixel weighs 1
    down, slope_down : rings of weights (or None) and slopes of the edges above each row
    """
    at = row % slope_down.shape[0]
    if weight is None:
        down_edges(q, rule, row, None, None, slope_down[at])
    else:
        for r in range(row - 2, row + 2):
            weight_row(weight, scale, r, pixels[r % 4])
        down_edges(q, rule, row, pixels, down[at], slope_down[at])


@njit(cache=True)
def next_edges(
    p: Any, q: Any, weight: Any, scale: Any, rule: Any, row: int, pixels: Any, across: Any, slope_across: Any,
    down: Any, slope_down: Any,
) -> None:  # fmt: skip
    """Make the edges left of and below the pixels of `row`; those of the rows before it have been made."""
    a, d = row % slope_across.shape[0], (row + 1) % slope_down.shape[0]
    if weight is None:
        across_edges(p[row], rule, None, None, slope_across[a])
        down_edges(q, rule, row + 1, None, None, slope_down[d])
    else:
        weight_row(weight, scale, row + 2, pixels[(row + 2) % 4])
        across_edges(p[row], rule, pixels[row % 4], across[a], slope_across[a])
        down_edges(q, rule, row + 1, pixels, down[d], slope_down[d])


@njit(cache=True, fastmath=CONTRACT)
def unit_divergence_row(across: Any, above: Any, below: Any, out: Any) -> None:
    """Write the right-hand side of a row, what its edges' slopes bring in less what they take out."""
    for c in range(out.size):
        out[c] = (across[c] - across[c + 1]) + (above[c] - below[c])


@njit(cache=True, fastmath=CONTRACT)
def divergence_row(
    across: Any, above: Any, below: Any, w_across: Any, w_above: Any, w_below: Any, out: Any
) -> None:  # fmt: skip
    """Write the right-hand side of a row, with the weight of each edge."""
    for c in range(out.size):
        sides = w_across[c] * across[c] - w_across[c + 1] * across[c + 1]
        out[c] = sides + (w_above[c] * above[c] - w_below[c] * below[c])


@njit(cache=True)
def system_row(
    row: int, across: Any, slope_across: Any, down: Any, slope_down: Any, rhs: Any, inverse: Any
) -> None:  # fmt: skip
    """Write the right-hand side and, unless `inverse` is None, the inverse diagonal of a row from its edges."""
    a, u, b = row % slope_across.shape[0], row % slope_down.shape[0], (row + 1) % slope_down.shape[0]
    out = rhs[row % rhs.shape[0]]
    if across is None:
        unit_divergence_row(slope_across[a], slope_down[u], slope_down[b], out)
    elif inverse is None:
        divergence_row(slope_across[a], slope_down[u], slope_down[b], across[a], down[u], down[b], out)
    else:
        system_and_diagonal(
            slope_across[a], slope_down[u], slope_down[b], across[a], down[u], down[b], out,
            inverse[row % inverse.shape[0]],
        )  # fmt: skip


@njit(cache=True)
def stored_or_made_row(
    row: int, across: Any, slope_across: Any, down: Any, slope_down: Any, rhs: Any, inverse: Any
) -> None:  # fmt: skip
    """As `system_row`; where there are no slopes (None) the right-hand side stands already."""
    if slope_across is not None:
        system_row(row, across, slope_across, down, slope_down, rhs, inverse)
    elif across is not None:
        inverse_diagonal(across[row], down[row], down[row + 1], inverse[row % inverse.shape[0]])


@njit(cache=True)
def ring(rows: int, columns: int) -> Any:
    """A float32 array of this shape, nought."""
    return np.zeros((rows, columns), np.float32)


@njit(cache=True)
def shape_rows(
    row: int, rows: int, across: Any, slope_across: Any, down: Any, slope_down: Any, nothing: Any, base: Any,
    upper: Any, lower: Any,
) -> None:  # fmt: skip
    """Write `row` (even) and the next one, if there is one: heights `base` of the cells over them and their shapes.

    nothing : float32 array of shape (W + 1,), nought, in the place of a missing row's edges
    """
    if slope_across is None:  # a pass over stored shapes never gets here, but is compiled with the call
        return
    a, b, d = row % slope_across.shape[0], (row + 1) % slope_across.shape[0], (row + 1) % slope_down.shape[0]
    width, single = upper.size, row + 1 == rows
    if across is None:
        if single:
            unit_shape(slope_across[a], slope_across[a], nothing[:width], base, upper, lower)
        else:
            unit_shape(slope_across[a], slope_across[b], slope_down[d], base, upper, lower)
    elif single:
        weighted_shape(
            slope_across[a], nothing, nothing[:width], across[a], nothing, nothing[:width], base, upper, lower
        )  # fmt: skip
    else:
        weighted_shape(
            slope_across[a], slope_across[b], slope_down[d], across[a], across[b], down[d], base, upper, lower
        )  # fmt: skip
