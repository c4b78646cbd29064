"""A full rectangle of equal weights is one island: its heights are taken to mean zero."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from device.surface import Float32Array
from host_sync.reconstruction.row_bands import in_bands


def level_rectangle(z: Float32Array, scale: float) -> None:
    """Scale z (float32 array of shape (H, W)) of a full rectangle in place to mean zero."""
    sums = np.zeros(z.shape[0])
    in_bands(_row_sums, z.shape, z, sums)
    in_bands(_scale, z.shape, z, np.float32(sums.sum() / z.size), np.float32(scale))


@njit(cache=True, nogil=True)
def _row_sums(z: Any, sums: Any, begin: int, end: int) -> None:
    """Write the sum of each row."""
    for r in range(begin, end):
        sums[r] = _row_sum(z[r])


@njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _row_sum(z: Any) -> Any:
    """Sum of a row, in lanes."""
    total = 0.0
    for c in range(z.size):
        total += z[c]
    return total


@njit(cache=True, nogil=True)
def _scale(z: Any, mean: Any, scale: Any, begin: int, end: int) -> None:
    """Write (z - mean) · scale."""
    for r in range(begin, end):
        for c in range(z.shape[1]):
            z[r, c] = (z[r, c] - mean) * scale
