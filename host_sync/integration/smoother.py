"""Chebyshev-Jacobi smoothing of a graph Laplacian, one row at a time.

A row's operator is written as a sum of neighbour differences, Σ w_e (z_neighbour - z). In float32 the form Dz - Σ w z
loses the small differences of a large height; for the same reason no compiler flag that reorders sums may be set here.
Jacobi sweeps read one array and write another, so the result does not depend on the number of threads.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.surface import Float32Array
from host_sync.kernels.jit import njit

LOWEST, HIGHEST = 0.5, 2.0
"""Range of eigenvalues of D⁻¹A that smoothing damps: the next level handles lower ones, and none exceeds 2."""

CONTRACT: Final = {"contract"}
"""Allows fused multiply-add; nothing may be reordered."""

REASSOCIATE: Final = {"reassoc", "nsz", "contract"}
"""Allows sums in vector lanes: for means and report values, not for heights."""


def chebyshev_steps(sweeps: int) -> Float32Array:
    """Return the relaxation factors of `sweeps` Jacobi sweeps, float32 array (sweeps,), best over [LOWEST, HIGHEST]."""
    angle = np.pi * (2 * np.arange(sweeps) + 1) / (2 * sweeps)
    return (2.0 / (HIGHEST + LOWEST + (HIGHEST - LOWEST) * np.cos(angle))).astype(np.float32)


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def inverse_diagonal(weight_x: Any, above: Any, below: Any, out: Any) -> None:
    """Write 1 / Σ w_e of a row's pixels, 0 for a pixel without edges."""
    one, zero = np.float32(1.0), np.float32(0.0)
    for c in range(out.size):
        total = (weight_x[c] + weight_x[c + 1]) + (above[c] + below[c])
        out[c] = one / total if total > zero else zero


@njit(cache=True, fastmath=CONTRACT, error_model="numpy")
def system_and_diagonal(
    slope_x: Any, slope_above: Any, slope_below: Any, weight_x: Any, weight_above: Any, weight_below: Any, rhs: Any,
    inverse: Any,
) -> None:  # fmt: skip
    """Write a row's right-hand side from its edges' slopes and weights, and 1 / Σ w_e as `inverse_diagonal`."""
    one, zero = np.float32(1.0), np.float32(0.0)
    for c in range(rhs.size):
        left, right, upper, lower = weight_x[c], weight_x[c + 1], weight_above[c], weight_below[c]
        rhs[c] = (left * slope_x[c] - right * slope_x[c + 1]) + (upper * slope_above[c] - lower * slope_below[c])
        total = (left + right) + (upper + lower)
        inverse[c] = one / total if total > zero else zero


@njit(cache=True, fastmath=CONTRACT)
def residual_row(up: Any, mid: Any, low: Any, rhs: Any, weight_x: Any, above: Any, below: Any, out: Any) -> None:
    """Write a row of b - Az; `up`, `mid`, `low` are rows of z with one pixel of padding at each end."""
    for c in range(rhs.size):
        z = mid[c + 1]
        sides = weight_x[c] * (mid[c] - z) + weight_x[c + 1] * (mid[c + 2] - z)
        out[c] = rhs[c] + (sides + (above[c] * (up[c + 1] - z) + below[c] * (low[c + 1] - z)))


@njit(cache=True, fastmath=CONTRACT)
def relax_row(
    up: Any, mid: Any, low: Any, rhs: Any, weight_x: Any, above: Any, below: Any, inverse: Any, step: Any, out: Any
) -> None:
    """Write a row of z + step D⁻¹(b - Az), without padding."""
    for c in range(rhs.size):
        z = mid[c + 1]
        sides = weight_x[c] * (mid[c] - z) + weight_x[c + 1] * (mid[c + 2] - z)
        flow = rhs[c] + (sides + (above[c] * (up[c + 1] - z) + below[c] * (low[c + 1] - z)))
        out[c] = z + step * inverse[c] * flow


@njit(cache=True)
def scale_row(rhs: Any, inverse: Any, step: Any, out: Any) -> None:
    """Write a row of step D⁻¹b: the first step from zero heights."""
    for c in range(out.size):
        out[c] = step * inverse[c] * rhs[c]


@njit(cache=True)
def unit_scale_row(rhs: Any, step: Any, out: Any) -> None:
    """As `scale_row` where every edge weighs 1 (see `unit_relax_row`)."""
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

    The denominator is 4 at the border too, where a pixel has fewer neighbours: then the steps keep the operator's
    eigenvectors, cosines, and Σ z does not change.
    """
    scale = np.float32(0.25) * step
    for c in range(rhs.size):
        z = mid[c + 1]
        out[c] = z + scale * (rhs[c] + (((mid[c] - z) + (mid[c + 2] - z)) + ((up[c + 1] - z) + (low[c + 1] - z))))


@njit(cache=True, fastmath=REASSOCIATE)
def square_sum(row: Any) -> Any:
    """Return the sum of a row's squares."""
    total = np.float32(0.0)
    for c in range(row.size):
        total += row[c] * row[c]
    return total


@njit(cache=True, fastmath=REASSOCIATE)
def square_difference(a: Any, b: Any) -> Any:
    """Return the sum of squared differences of two rows."""
    total = np.float32(0.0)
    for c in range(a.size):
        total += (a[c] - b[c]) * (a[c] - b[c])
    return total
