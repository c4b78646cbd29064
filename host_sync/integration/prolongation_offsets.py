"""Prolongation offsets: heights of the 2x2 fine pixels of a cell relative to their coarse pixel, from the slopes
between.

The four edges inside a cell form a loop. Its closure error is distributed over them so that Σ w_e (change)² is least,
which is their own least-squares surface. A missing slope follows from the other three, or equals that of the opposite
edge.

The fine field is the coarse field plus offsets, so the least squares over coarse pixels have slopes

    G = Σ w_e (g_e + d_a - d_b) / Σ w_e

over the fine edges e = (a, b) between two cells. Slopes that belong to a surface give exactly that surface on every
level, whatever the weights: full multigrid has only noise left to smooth and correct. (Compare Hampton et al. 2008, who
integrate wave-front slopes by Haar wavelets and smooth after each level.)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from host_sync.integration.edges import TINY, first_of, second_of
from host_sync.integration.smoother import CONTRACT
from host_sync.kernels.jit import njit


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
    """Contribution of a fine edge to the weight of the coarse edge that crosses it.

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
