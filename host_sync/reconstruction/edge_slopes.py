"""Right-hand side of the least squares: slopes averaged onto the edges between neighbouring pixels.

An edge joins pixels a and b in line. The two-point mean (g_a + g_b) / 2 has variance (v_a + v_b) / 4, so that with
weights w = 1 / v an edge deserves the harmonic mean w_e = 2 w_a w_b / (w_a + w_b) (up to a factor common to all).

Rules for the edge's height difference, in pixels (g_o and g_p lie beyond a and b):

* fourth-order: 13/24 (g_a + g_b) - 1/24 (g_o + g_p). The mean of a cubic over [0, 1] from its values at -1, 0, 1, 2:
  even parts 1 and (x - 1/2)² give α + β = 1/2 and α/4 + 9β/4 = 1/24, so β = -1/24, α = 13/24; odd parts cancel.
  Where g_o or g_p is missing, or so uncertain that its share of the edge's variance would count, the two-point mean.
* two-point: (g_a + g_b) / 2.
* printed: g_a, the one-sided difference of the paper's eq. 10, for comparison.
"""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
from numba import njit, prange

from device.surface import Float32Array
from host_sync.reconstruction.smoother import CONTRACT

EdgeRule = Literal["fourth-order", "two-point", "printed"]

LEAST_OUTER: Final = np.float32(0.01)
"""Weight of an outer pixel, relative to its edge, under which it takes no part: it adds at most 1/3 to the variance."""

_COEFFICIENTS: Final = {
    "fourth-order": (0.5, 0.5, 1.0 / 24.0),
    "two-point": (0.5, 0.5, 0.0),
    "printed": (1.0, 0.0, 0.0),
}


def edge_coefficients(rule: EdgeRule) -> Float32Array:
    """Coefficients (α, β, γ) of α g_a + β g_b + γ ((g_a + g_b) - (g_o + g_p)), float32."""
    return np.asarray(_COEFFICIENTS[rule], np.float32)


@njit(cache=True, fastmath=CONTRACT)
def _edge_row(
    g_o: Any, g_a: Any, g_b: Any, g_p: Any, w_o: Any, w_a: Any, w_b: Any, w_p: Any, rule: Any, weight: Any, flux: Any
) -> None:
    """Write weight and weighted slope of a row of edges."""
    two, nought = np.float32(2.0), np.float32(0.0)
    for i in range(weight.size):
        joined = w_a[i] > nought and w_b[i] > nought
        w = two * w_a[i] * w_b[i] / (w_a[i] + w_b[i]) if joined else nought
        both = g_a[i] + g_b[i]
        outer = g_o[i] + g_p[i]
        trusted = joined and w_o[i] > LEAST_OUTER * w and w_p[i] > LEAST_OUTER * w
        bend = rule[2] * (both - outer) if trusted else nought
        slope = rule[0] * g_a[i] + rule[1] * g_b[i] + bend
        weight[i] = w
        flux[i] = w * slope if joined else nought


@njit(cache=True)
def _padded(values: Any, row: int, out: Any) -> None:
    """Copy a row between two pixels of padding at each end."""
    out[2 : out.size - 2] = values[row]


@njit(cache=True)
def _weight_row(weight: Any, valid: Any, row: int, out: Any) -> None:
    """Write a row of pixel weights between two pixels of padding: nought at holes and outside; 1 without `weight`."""
    rows, columns = valid.shape
    nought = np.float32(0.0)
    if 0 <= row < rows:
        for c in range(columns):
            if weight is None:
                out[c + 2] = np.float32(1.0)
            else:
                out[c + 2] = weight[row, c] if valid[row, c] else nought
    else:
        out[:] = nought


@njit(cache=True)
def _band(
    p: Any, q: Any, weight: Any, valid: Any, rule: Any, across: Any, down: Any, rhs: Any, first: int, last: int
) -> None:
    """Write edge weights and right-hand side of rows `first` to `last` - 1."""
    rows, columns = p.shape
    w = np.zeros((4, columns + 4), np.float32)
    p_row = np.zeros(columns + 4, np.float32)
    edge, flux = np.zeros(columns + 1, np.float32), np.zeros(columns + 1, np.float32)
    edges_down, flux_down = np.zeros(columns, np.float32), np.zeros((2, columns), np.float32)
    for row in range(first - 2, first + 1):
        _weight_row(weight, valid, row, w[row % 4])
    for r in range(first, last + 1):
        _weight_row(weight, valid, r + 1, w[(r + 1) % 4])
        o, a, b, e = max(r - 2, 0), max(r - 1, 0), min(r, rows - 1), min(r + 1, rows - 1)
        inner = slice(2, columns + 2)
        _edge_row(
            q[o], q[a], q[b], q[e], w[(r - 2) % 4][inner], w[(r - 1) % 4][inner], w[r % 4][inner],
            w[(r + 1) % 4][inner], rule, edges_down, flux_down[r % 2],
        )  # fmt: skip
        if down is not None and (r < last or r == rows):
            down[r] = edges_down
        if r > first:
            above, below = flux_down[(r - 1) % 2], flux_down[r % 2]
            for c in range(columns):
                rhs[r - 1, c] += above[c] - below[c]
        if r == last:
            break
        p_row[2 : columns + 2] = p[r]
        mid = w[r % 4]
        n = columns + 1
        _edge_row(
            p_row[0:n], p_row[1 : n + 1], p_row[2 : n + 2], p_row[3 : n + 3],
            mid[0:n], mid[1 : n + 1], mid[2 : n + 2], mid[3 : n + 3], rule, edge, flux,
        )  # fmt: skip
        if across is not None:
            across[r] = edge
        for c in range(columns):
            rhs[r, c] = flux[c] - flux[c + 1]


@njit(cache=True, parallel=True)
def edge_system(
    p: Any, q: Any, weight: Any, valid: Any, rule: Any, across: Any, down: Any, rhs: Any, bands: int
) -> None:
    """Write the edge weights and right-hand side of the finest level.

    p, q : float32 arrays of shape (H, W); whatever stands at holes is not read into a result
    weight : float32 array of shape (H, W), or None where every pixel weighs 1
    valid : bool array of shape (H, W)
    rule : `edge_coefficients`
    across : float32 array of shape (H, W + 1), or None: weights of the edges left of each pixel, nought at both ends
    down : float32 array of shape (H + 1, W), or None: weights of the edges above each pixel, nought at both ends
    rhs : float32 array of shape (H, W), divergence of the weighted edge slopes, pixels
    """
    rows = p.shape[0]
    for band in prange(bands):
        _band(p, q, weight, valid, rule, across, down, rhs, band * rows // bands, (band + 1) * rows // bands)
