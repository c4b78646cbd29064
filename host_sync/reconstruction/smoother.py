"""Chebyshev-Jacobi smoothing of a graph Laplacian, one row at a time.

A row's operator is written as a sum of neighbour differences, Σ w_e (z_neighbour - z): in float32 the form Dz - Σ w z
loses the small differences of a large height, and no compiler flag that reorders sums may be set here for that reason.
Jacobi sweeps read one array and write another, so the result cannot depend on the number of threads.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

from device.surface import Float32Array

LOWEST, HIGHEST = 0.5, 2.0
"""Eigenvalues of D⁻¹A that smoothing has to damp: the next level sees the lower ones, and none exceeds 2."""

CONTRACT: Final = {"contract"}
"""A product and a sum may become one instruction; nothing may be reordered."""

IN_LANES: Final = {"reassoc", "nsz", "contract"}
"""Sums may be taken in lanes: those that no height is made from, but means and figures for the report."""


def chebyshev_steps(sweeps: int) -> Float32Array:
    """Relaxation factors of `sweeps` Jacobi sweeps, float32 array of shape (sweeps,), best over [LOWEST, HIGHEST]."""
    angle = np.pi * (2 * np.arange(sweeps) + 1) / (2 * sweeps)
    return (2.0 / (HIGHEST + LOWEST + (HIGHEST - LOWEST) * np.cos(angle))).astype(np.float32)


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def inverse_diagonal(across: Any, above: Any, below: Any, out: Any) -> None:
    """Write 1 / Σ w_e of a row's pixels, nought for a pixel without edges."""
    one, nought = np.float32(1.0), np.float32(0.0)
    for c in range(out.size):
        total = (across[c] + across[c + 1]) + (above[c] + below[c])
        out[c] = one / total if total > nought else nought


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def system_and_diagonal(
    across: Any, above: Any, below: Any, w_across: Any, w_above: Any, w_below: Any, rhs: Any, inverse: Any
) -> None:  # fmt: skip
    """Write a row's right-hand side from its edges' slopes and weights, and 1 / Σ w_e as `inverse_diagonal`."""
    one, nought = np.float32(1.0), np.float32(0.0)
    for c in range(rhs.size):
        left, right, upper, lower = w_across[c], w_across[c + 1], w_above[c], w_below[c]
        rhs[c] = (left * across[c] - right * across[c + 1]) + (upper * above[c] - lower * below[c])
        total = (left + right) + (upper + lower)
        inverse[c] = one / total if total > nought else nought


@njit(cache=True, fastmath=CONTRACT)
def residual_row(up: Any, mid: Any, low: Any, rhs: Any, across: Any, above: Any, below: Any, out: Any) -> None:
    """Write a row of b - Az; `up`, `mid`, `low` are rows of z with one pixel of padding at each end."""
    for c in range(rhs.size):
        z = mid[c + 1]
        sides = across[c] * (mid[c] - z) + across[c + 1] * (mid[c + 2] - z)
        out[c] = rhs[c] + (sides + (above[c] * (up[c + 1] - z) + below[c] * (low[c + 1] - z)))


@njit(cache=True, fastmath=CONTRACT)
def relax_row(
    up: Any, mid: Any, low: Any, rhs: Any, across: Any, above: Any, below: Any, inverse: Any, step: Any, out: Any
) -> None:
    """Write a row of z + step D⁻¹(b - Az), without padding."""
    for c in range(rhs.size):
        z = mid[c + 1]
        sides = across[c] * (mid[c] - z) + across[c + 1] * (mid[c + 2] - z)
        flow = rhs[c] + (sides + (above[c] * (up[c + 1] - z) + below[c] * (low[c + 1] - z)))
        out[c] = z + step * inverse[c] * flow


@njit(cache=True)
def scale_row(rhs: Any, inverse: Any, step: Any, out: Any) -> None:
    """Write a row of step D⁻¹b: the step from heights that are nought."""
    for c in range(out.size):
        out[c] = step * inverse[c] * rhs[c]


@njit(cache=True)
def unit_scale_row(rhs: Any, step: Any, out: Any) -> None:
    """The same where every edge weighs 1, as `unit_relax_row`."""
    scale = np.float32(0.25) * step
    for c in range(out.size):
        out[c] = scale * rhs[c]


@njit(cache=True, fastmath=CONTRACT)
def unit_residual_row(up: Any, mid: Any, low: Any, rhs: Any, out: Any) -> None:
    """Write a row of b - Az where every edge weighs 1 and padding repeats the border."""
    for c in range(rhs.size):
        z = mid[c + 1]
        out[c] = rhs[c] + (((mid[c] - z) + (mid[c + 2] - z)) + ((up[c + 1] - z) + (low[c + 1] - z)))


@njit(cache=True, fastmath=CONTRACT)
def unit_relax_row(up: Any, mid: Any, low: Any, rhs: Any, step: Any, out: Any) -> None:
    """Write a row of z + step (b - Az) / 4 where every edge weighs 1, without padding.

    Four stands at the border too, where a pixel has fewer neighbours: the operator's eigenvectors are then those of
    the steps, cosines, and Σ z stays as it is.
    """
    scale = np.float32(0.25) * step
    for c in range(rhs.size):
        z = mid[c + 1]
        out[c] = z + scale * (rhs[c] + (((mid[c] - z) + (mid[c + 2] - z)) + ((up[c + 1] - z) + (low[c + 1] - z))))


@njit(cache=True, fastmath=IN_LANES)
def square_sum(row: Any) -> Any:
    """Sum of a row's squares."""
    total = np.float32(0.0)
    for c in range(row.size):
        total += row[c] * row[c]
    return total


@njit(cache=True, fastmath=IN_LANES)
def square_difference(a: Any, b: Any) -> Any:
    """Sum of the squares of two rows' difference."""
    total = np.float32(0.0)
    for c in range(a.size):
        total += (a[c] - b[c]) * (a[c] - b[c])
    return total
