"""Slopes of a full-size height map in one pass over memory: the workstation's form of `surface_slopes`."""

from __future__ import annotations

from typing import Any

import numpy as np

from device.surface import MIN_FOURTH_ORDER, Float32Array, HeightMap
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows


def surface_slopes(height: HeightMap) -> tuple[Float32Array, Float32Array]:
    """Return slopes (p, q) by central differences: float32 arrays of shape (H, W), the portable ones but for rounding.

    H and W are at least 2.
    """
    z_um = np.ascontiguousarray(height.z_um, np.float32)
    p, q = np.empty_like(z_um), np.empty_like(z_um)
    parallel_rows(_write_slopes, z_um.shape, z_um, np.float32(1.0 / height.pitch_um), p, q)
    return p, q


@njit(cache=True, nogil=True)
def _write_slopes(z: Any, per_um: Any, p: Any, q: Any, first: int, last: int) -> None:
    rows = len(z)
    for r in range(first, last):
        _across(z[r], per_um, p[r])
        above, below = z[max(r - 1, 0)], z[min(r + 1, rows - 1)]
        if rows > MIN_FOURTH_ORDER and 2 <= r < rows - 2:
            _between(z[r - 2], above, below, z[r + 2], per_um, q[r])
        else:
            _difference(above, below, per_um / np.float32(min(r + 1, rows - 1) - max(r - 1, 0)), q[r])


@njit(cache=True)
def _across(z: Any, per_um: Any, p: Any) -> None:
    last = z.size - 1
    p[0], p[last] = (z[1] - z[0]) * per_um, (z[last] - z[last - 1]) * per_um
    _difference(z[: last - 1], z[2:], np.float32(0.5) * per_um, p[1:last])
    if z.size > MIN_FOURTH_ORDER:
        _between(z[: last - 3], z[1 : last - 2], z[3:last], z[4:], per_um, p[2 : last - 1])


@njit(cache=True)
def _difference(before: Any, after: Any, share: Any, out: Any) -> None:
    for c in range(out.size):
        out[c] = (after[c] - before[c]) * share


@njit(cache=True)
def _between(second: Any, before: Any, after: Any, next_but_one: Any, per_um: Any, out: Any) -> None:
    """Fourth order where all four are numbers, second order where the nearer two are."""
    twelfth, half, eight = per_um / np.float32(12.0), np.float32(0.5) * per_um, np.float32(8.0)
    for c in range(out.size):
        near = after[c] - before[c]
        far = eight * near - (next_but_one[c] - second[c])
        out[c] = far * twelfth if np.isfinite(far) else near * half
