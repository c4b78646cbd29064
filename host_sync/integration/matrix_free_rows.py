"""Rows of a level's system, read where they are stored, else built from the pixels' slopes (matrix-free).

The finest level is large and its edges are cheap to compute, so none are stored: each pass rebuilds them from p, q and
the weights, in ring buffers of the last few rows. Row r is at index r mod length, which for a stored level is r itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from host_sync.integration.edges import weight_row, x_edges, y_edges
from host_sync.integration.levels import FineLevel, GridLevel, new_level
from host_sync.integration.prolongation_offsets import unit_offsets, weighted_offsets
from host_sync.integration.smoother import CONTRACT, inverse_diagonal, system_and_diagonal
from host_sync.kernels.jit import njit


def build_level(field: FineLevel) -> GridLevel:
    """The pixels' own level with all its edges and its right-hand side stored."""
    level = new_level((field.p.shape[0], field.p.shape[1]), field.weight is not None)
    _write_edges(
        field.p, field.q, field.weight, field.scale, field.rule, level.weight_x, level.slope_x, level.weight_y,
        level.slope_y, level.rhs,
    )  # fmt: skip
    return level


@njit(cache=True)
def _write_edges(
    p: Any, q: Any, weight: Any, scale: Any, rule: Any, weight_x: Any, slope_x: Any, weight_y: Any, slope_y: Any,
    rhs: Any,
) -> None:  # fmt: skip
    """Write all edges and the right-hand side, row by row."""
    rows, columns = p.shape
    pixels = None if weight is None else ring(4, columns + 4)
    begin_edges(q, weight, scale, rule, 0, pixels, weight_y, slope_y)
    for r in range(rows):
        advance_edges(p, q, weight, scale, rule, r, pixels, weight_x, slope_x, weight_y, slope_y)
        system_row(r, weight_x, slope_x, weight_y, slope_y, rhs, None)


@njit(cache=True)
def begin_edges(
    q: Any, weight: Any, scale: Any, rule: Any, row: int, pixels: Any, weight_y: Any, slope_y: Any
) -> None:  # fmt: skip
    """Build the edges above `row`, where a pass begins.

    q, weight : float32 arrays of shape (H, W); `weight` is None where every pixel weighs 1, else 0 at holes
    scale : factor of the weights
    rule : `edge_coefficients`
    pixels : ring of 4 padded rows of pixel weights; None where every pixel weighs 1
    weight_y, slope_y : rings of weights (or None) and slopes of the edges above each row
    """
    at = row % slope_y.shape[0]
    if weight is None:
        y_edges(q, rule, row, None, None, slope_y[at])
    else:
        for r in range(row - 2, row + 2):
            weight_row(weight, scale, r, pixels[r % 4])
        y_edges(q, rule, row, pixels, weight_y[at], slope_y[at])


@njit(cache=True)
def advance_edges(
    p: Any, q: Any, weight: Any, scale: Any, rule: Any, row: int, pixels: Any, weight_x: Any, slope_x: Any,
    weight_y: Any, slope_y: Any,
) -> None:  # fmt: skip
    """Build the edges left of and below the pixels of `row`; those of earlier rows exist."""
    a, d = row % slope_x.shape[0], (row + 1) % slope_y.shape[0]
    if weight is None:
        x_edges(p[row], rule, None, None, slope_x[a])
        y_edges(q, rule, row + 1, None, None, slope_y[d])
    else:
        weight_row(weight, scale, row + 2, pixels[(row + 2) % 4])
        x_edges(p[row], rule, pixels[row % 4], weight_x[a], slope_x[a])
        y_edges(q, rule, row + 1, pixels, weight_y[d], slope_y[d])


@njit(cache=True, fastmath=CONTRACT)
def unit_divergence_row(slope_x: Any, slope_above: Any, slope_below: Any, out: Any) -> None:
    """Write the right-hand side of a row, the divergence of its edges' slopes."""
    for c in range(out.size):
        out[c] = (slope_x[c] - slope_x[c + 1]) + (slope_above[c] - slope_below[c])


@njit(cache=True, fastmath=CONTRACT)
def divergence_row(
    slope_x: Any, slope_above: Any, slope_below: Any, weight_x: Any, weight_above: Any, weight_below: Any, out: Any
) -> None:  # fmt: skip
    """Write the right-hand side of a row, with the weight of each edge."""
    for c in range(out.size):
        sides = weight_x[c] * slope_x[c] - weight_x[c + 1] * slope_x[c + 1]
        out[c] = sides + (weight_above[c] * slope_above[c] - weight_below[c] * slope_below[c])


@njit(cache=True)
def system_row(
    row: int, weight_x: Any, slope_x: Any, weight_y: Any, slope_y: Any, rhs: Any, inverse: Any
) -> None:  # fmt: skip
    """Write the right-hand side and, unless `inverse` is None, the inverse diagonal of a row from its edges."""
    a, u, b = row % slope_x.shape[0], row % slope_y.shape[0], (row + 1) % slope_y.shape[0]
    out = rhs[row % rhs.shape[0]]
    if weight_x is None:
        unit_divergence_row(slope_x[a], slope_y[u], slope_y[b], out)
    elif inverse is None:
        divergence_row(slope_x[a], slope_y[u], slope_y[b], weight_x[a], weight_y[u], weight_y[b], out)
    else:
        system_and_diagonal(
            slope_x[a], slope_y[u], slope_y[b], weight_x[a], weight_y[u], weight_y[b], out,
            inverse[row % inverse.shape[0]],
        )  # fmt: skip


@njit(cache=True)
def load_or_build_row(
    row: int, weight_x: Any, slope_x: Any, weight_y: Any, slope_y: Any, rhs: Any, inverse: Any
) -> None:  # fmt: skip
    """As `system_row`; where there are no slopes (None) the right-hand side is stored already."""
    if slope_x is not None:
        system_row(row, weight_x, slope_x, weight_y, slope_y, rhs, inverse)
    elif weight_x is not None:
        inverse_diagonal(weight_x[row], weight_y[row], weight_y[row + 1], inverse[row % inverse.shape[0]])


@njit(cache=True)
def ring(rows: int, columns: int) -> Any:
    """A float32 array of zeros, used as a ring buffer of rows."""
    return np.zeros((rows, columns), np.float32)


@njit(cache=True)
def offset_rows(
    row: int, rows: int, weight_x: Any, slope_x: Any, weight_y: Any, slope_y: Any, nothing: Any, base: Any,
    upper: Any, lower: Any,
) -> None:  # fmt: skip
    """Write `row` (even) and the next one, if there is one: the cells' heights `base` plus prolongation offsets.

    nothing : float32 array of zeros, shape (W + 1,), in place of the edges of a missing row
    """
    if slope_x is None:  # not reached with stored offsets, but compiled for them
        return
    a, b, d = row % slope_x.shape[0], (row + 1) % slope_x.shape[0], (row + 1) % slope_y.shape[0]
    width, single = upper.size, row + 1 == rows
    if weight_x is None:
        if single:
            unit_offsets(slope_x[a], slope_x[a], nothing[:width], base, upper, lower)
        else:
            unit_offsets(slope_x[a], slope_x[b], slope_y[d], base, upper, lower)
    elif single:
        weighted_offsets(
            slope_x[a], nothing, nothing[:width], weight_x[a], nothing, nothing[:width], base, upper, lower
        )  # fmt: skip
    else:
        weighted_offsets(
            slope_x[a], slope_x[b], slope_y[d], weight_x[a], weight_x[b], weight_y[d], base, upper, lower
        )  # fmt: skip
