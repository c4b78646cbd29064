"""A height map between its pixels. Why not OpenCV's remap: it knows places to a thirty-second of a pixel only."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numba import njit

from device.surface import Float32Array


def between_pixels(z_um: Float32Array, row: Float32Array, column: Float32Array) -> Float32Array:
    """Heights at places (px) by cubic convolution: float32 array of the places' shape.

    NaN where one of the 4 × 4 pixels around is invalid or beyond the border.
    """
    found = np.empty(row.shape, np.float32)
    _convolve(np.ascontiguousarray(z_um), np.ascontiguousarray(row), np.ascontiguousarray(column), found)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _weights(t: Any) -> Any:
    """Weights of the pixels one before, at, one and two after a place that lies `t` of a pixel further."""
    t2, t3 = t * t, t * t * t
    return (
        np.float32(0.5 * (-t3 + 2.0 * t2 - t)),
        np.float32(0.5 * (3.0 * t3 - 5.0 * t2 + 2.0)),
        np.float32(0.5 * (-3.0 * t3 + 4.0 * t2 + t)),
        np.float32(0.5 * (t3 - t2)),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _convolve(z_um: Any, row: Any, column: Any, found: Any) -> None:
    """Write the heights."""
    rows, columns = z_um.shape
    for r in range(found.shape[0]):
        for c in range(found.shape[1]):
            at_row, at_column = int(np.floor(row[r, c])), int(np.floor(column[r, c]))
            if at_row < 1 or at_column < 1 or at_row + 2 >= rows or at_column + 2 >= columns:
                found[r, c] = np.nan
                continue
            down = _weights(row[r, c] - np.float32(at_row))
            right = _weights(column[r, c] - np.float32(at_column))
            total = np.float32(0.0)
            for i in range(4):
                line = np.float32(0.0)
                for j in range(4):
                    line += right[j] * z_um[at_row - 1 + i, at_column - 1 + j]
                total += down[i] * line
            found[r, c] = total


def reduced(z_um: Float32Array, step: int) -> Float32Array:
    """The means over squares of so many pixels; rows and columns beyond the last whole square are left out."""
    if step == 1:
        return z_um
    rows, columns = (size // step for size in z_um.shape)
    part = z_um[: rows * step, : columns * step]
    return np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
