"""A full rectangle of equal weights is one island: its heights are taken to mean zero."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from device.surface import Float32Array
from host_sync.reconstruction.islands import row_sum, subtract
from host_sync.reconstruction.row_bands import in_bands


def level_rectangle(z: Float32Array) -> None:
    """Bring z (float32 array of shape (H, W)) of a full rectangle in place to mean zero."""
    in_bands(_subtract_rows, z.shape, z, np.float32(_row_sums(z).sum() / z.size))


def level_cells(z: Float32Array, shape: tuple[int, int]) -> None:
    """Bring the cells z of a full rectangle of `shape` in place to mean zero over its pixels.

    Smoothing and the shapes of cells leave the mean of the pixels what it is.
    """
    rows, columns = shape
    of_rows, of_last = 2.0 * _row_sums(z), z[:, -1].astype(np.float64)
    if columns % 2:
        of_rows -= of_last
    pixels = np.full(len(z), 2.0)
    if rows % 2:
        pixels[-1] = 1.0
    in_bands(_subtract_rows, z.shape, z, np.float32((of_rows * pixels).sum() / (rows * columns)))


def _row_sums(z: Float32Array) -> Any:
    sums = np.zeros(z.shape[0])
    in_bands(_write_row_sums, z.shape, z, sums)
    return sums


@njit(cache=True, nogil=True)
def _write_row_sums(z: Any, sums: Any, begin: int, end: int) -> None:
    """Write the sum of each row."""
    for r in range(begin, end):
        sums[r] = row_sum(z[r])


@njit(cache=True, nogil=True)
def _subtract_rows(z: Any, mean: Any, begin: int, end: int) -> None:
    for r in range(begin, end):
        subtract(z[r], mean)
