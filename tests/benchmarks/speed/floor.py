"""The floor: reading two slopes and writing a height for every pixel, and nothing else. No integrator can do less."""

from __future__ import annotations

from typing import Any

from numba import njit, prange


@njit(cache=True, parallel=True)
def read_slopes_write_heights(p: Any, q: Any, z: Any) -> None:
    """Write p + q to z; float32 arrays of shape (H, W)."""
    for r in prange(p.shape[0]):
        for c in range(p.shape[1]):
            z[r, c] = p[r, c] + q[r, c]
