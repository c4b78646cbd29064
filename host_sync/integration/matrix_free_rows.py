"""Rows of a level's system, read where they are stored, else built from the pixels' slopes (matrix-free).

The finest level is large and its edges are cheap to compute, so none are stored: each pass rebuilds them from p, q and
the weights, in ring buffers of the last few rows. Row r is at index r mod length, which for a stored level is r itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from host_sync.integration.levels import (
    TINY,
    FineLevel,
    GridLevel,
    first_of,
    new_level,
    second_of,
    weight_row,
    x_edges,
    y_edges,
)
from host_sync.integration.smoother import CONTRACT, inverse_diagonal, system_and_diagonal
from host_sync.kernels.jit import njit

# Prolongation offsets: heights of the 2x2 fine pixels of a cell relative to their coarse pixel, from the slopes
# between.
#
# The four edges inside a cell form a loop. Its closure error is distributed over them so that Σ w_e (change)² is least,
# which is their own least-squares surface. A missing slope follows from the other three, or equals that of the opposite
# edge.
#
# The fine field is the coarse field plus offsets, so the least squares over coarse pixels have slopes
#
#     G = Σ w_e (g_e + d_a - d_b) / Σ w_e
#
# over the fine edges e = (a, b) between two cells. Slopes that belong to a surface give exactly that surface on every
# level, whatever the weights: full multigrid has only noise left to smooth and correct. (Compare Hampton et al. 2008,
# who integrate wave-front slopes by Haar wavelets and smooth after each level.)


@njit(cache=True, fastmath=CONTRACT)
def unit_offsets(top: Any, bottom: Any, middle: Any, base: Any, upper: Any, lower: Any) -> None:
    """Write the heights of a row of cells where every edge weighs 1.

    top, bottom : slopes of the edges left of each pixel of the upper and lower row, shape (W + 1,)
    middle : slopes of the edges between both rows, shape (W,)
    base : heights of the cells, to which offsets are added
    upper, lower : receive the heights of both rows' pixels, shape (W,)
    """
    quarter, eighth, half = np.float32(0.25), np.float32(0.125), np.float32(0.5)
    width = upper.size
    for i in range(width // 2):
        t, b, left, right = second_of(top, i), second_of(bottom, i), middle[2 * i], middle[2 * i + 1]
        x, y, twist = quarter * (t + b), quarter * (left + right), eighth * ((b - t) + (right - left))
        up, weight_y, z = twist - y, y - twist, base[i]
        upper[2 * i], upper[2 * i + 1] = z + (up - x), z + (x - (twist + y))
        lower[2 * i], lower[2 * i + 1] = z + (weight_y - x), z + (x + (y + twist))
    if width % 2:
        z, y = base[width // 2], half * middle[width - 1]
        upper[width - 1], lower[width - 1] = z - y, z + y


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def weighted_offsets(
    top: Any, bottom: Any, middle: Any, w_top: Any, w_bottom: Any, w_middle: Any, base: Any, upper: Any,
    lower: Any,
) -> None:  # fmt: skip
    """As `unit_offsets`, with the weight of each edge, 0 where it is missing."""
    quarter, eighth, half, zero = np.float32(0.25), np.float32(0.125), np.float32(0.5), np.float32(0.0)
    width = upper.size
    for i in range(width // 2):
        w_t, w_b, w_l, w_r = second_of(w_top, i), second_of(w_bottom, i), w_middle[2 * i], w_middle[2 * i + 1]
        g_t, g_b, g_l, g_r = second_of(top, i), second_of(bottom, i), middle[2 * i], middle[2 * i + 1]
        t, b = g_t if w_t > zero else g_b, g_b if w_b > zero else g_t
        left, right = g_l if w_l > zero else g_r, g_r if w_r > zero else g_l
        both_x, both_y = w_t * w_b, w_l * w_r
        s_t, s_b, s_l, s_r = w_b * both_y, w_t * both_y, w_r * both_x, w_l * both_x
        total = (s_t + s_b) + (s_l + s_r)
        gap = ((t - b) + (right - left)) / max(total, TINY)
        t, b, left, right = t - gap * s_t, b + gap * s_b, left + gap * s_l, right - gap * s_r
        x, y, twist = quarter * (t + b), quarter * (left + right), eighth * ((b - t) + (right - left))
        up, weight_y, z = twist - y, y - twist, base[i]
        upper[2 * i], upper[2 * i + 1] = z + (up - x), z + (x - (twist + y))
        lower[2 * i], lower[2 * i + 1] = z + (weight_y - x), z + (x + (y + twist))
    if width % 2:
        z, y = base[width // 2], half * middle[width - 1]
        upper[width - 1], lower[width - 1] = z - y, z + y


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def conductance(edge: Any, before: Any, after: Any, damping: Any) -> Any:
    """Return the contribution of a fine edge to the weight of the coarse edge that crosses it.

    A mean of two bounds, with weights 1 - `damping` and `damping`: neighbouring paths joined (half the edge), or
    separate (the edge in series with half of the one `before` and half of the one `after` it). Where weights vary, the
    first makes coarse corrections too small, and the second can make them so large that cycles diverge.
    """
    zero, half = np.float32(0.0), np.float32(0.5)
    first, second = before if before > zero else edge, after if after > zero else edge
    both = first * second
    series = edge * ((both + both) / max(edge * (first + second) + (both + both), TINY))
    joined = half * edge
    return joined + damping * (series - joined)


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def coarse_x_edges(
    top: Any, bottom: Any, w_top: Any, w_bottom: Any, upper: Any, lower: Any, damping: Any,
    weight: Any, out: Any,
) -> None:  # fmt: skip
    """Write weights and slopes of the edges left of a row of coarse pixels."""
    zero = np.float32(0.0)
    for i in range(1, out.size - 1):
        c = 2 * i
        a, b = w_top[c], w_bottom[c]
        here, there = first_of(top, i), first_of(bottom, i)
        flow = a * (here + (upper[c - 1] - upper[c])) + b * (there + (lower[c - 1] - lower[c]))
        out[i] = flow / max(a + b, TINY)
        first = conductance(a, second_of(w_top, i - 1), w_top[c + 1], damping)
        weight[i] = first + conductance(b, second_of(w_bottom, i - 1), w_bottom[c + 1], damping)
    out[0], out[out.size - 1], weight[0], weight[out.size - 1] = zero, zero, zero, zero


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def coarse_y_edges(
    edges: Any, w_before: Any, w_edges: Any, w_after: Any, above: Any, below: Any, damping: Any, weight: Any,
    out: Any,
) -> None:  # fmt: skip
    """Write weights and slopes of the edges above a row of coarse pixels; w_before, w_after: edges above, below."""
    width = edges.size
    for i in range(width // 2):
        c, d = 2 * i, 2 * i + 1
        a, b = w_edges[c], w_edges[d]
        flow = a * (edges[c] + (above[c] - below[c])) + b * (edges[d] + (above[d] - below[d]))
        out[i] = flow / max(a + b, TINY)
        first = conductance(a, w_before[c], w_after[c], damping)
        weight[i] = first + conductance(b, w_before[d], w_after[d], damping)
    if width % 2:
        c = width - 1
        out[out.size - 1] = edges[c] + (above[c] - below[c])
        weight[out.size - 1] = conductance(w_edges[c], w_before[c], w_after[c], damping)


def build_level(field: FineLevel) -> GridLevel:
    """Return the pixels' own level with all its edges and its right-hand side stored."""
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
    """Return a float32 array of zeros, used as a ring buffer of rows."""
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
