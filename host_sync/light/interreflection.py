"""Light from skin to skin: one bounce over cells by form factors (Nayar, Ikeuchi, Kanade, IJCV 6, 1991)."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from device.surface import Float32Array, Float64Array
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

WIDEST_CELLS: Final = 96
SCAN_CELLS: Final = 48
"""Cells along the columns, at most, of presses that a model is fitted to and of scans: the number of pairs grows with
its fourth power."""

SLANTED: Final = 0.02
RAISED_CELLS: Final = 0.25
"""Slope, and elevation in cells, from which a cell exchanges light with others; level skin at rest adds nothing."""


def incoming_light(
    shown: Float64Array, p: Float32Array, q: Float32Array, z_cells: Float32Array, widest: int = WIDEST_CELLS
) -> Float64Array:
    """Return the light that reaches each cell from all other cells: float64 array of shape (h, w, C).

    shown : radiance of cells, shape (h, w, C)
    p, q : slopes of cells, shape (h, w)
    z_cells : elevation over skin at rest, cells, shape (h, w)
    widest : cells along the columns between which light is exchanged, at most
    """
    rows, columns = z_cells.shape
    factor = max(1, -(-columns // widest))
    size = (-(-columns // factor), -(-rows // factor))

    def reduced(values: Any) -> Float64Array:
        small = cv2.resize(np.ascontiguousarray(values, np.float64), size, interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(small, np.float64)

    light = reduced(shown).reshape(*size[::-1], -1)
    slopes, z = (reduced(p), reduced(q)), reduced(z_cells) / factor
    active = (np.hypot(*slopes) > SLANTED) | (np.abs(z) > RAISED_CELLS)
    found = np.zeros_like(light)
    if active.any():
        work = size[1], size[0] * size[0] * size[1] // 64
        parallel_rows(_write_incoming, work, light, *slopes, z, active, found)
    large = cv2.resize(found, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return np.asarray(large, np.float64).reshape(shown.shape)


@njit(cache=True, nogil=True, error_model="numpy")
def _write_incoming(light: Any, p: Any, q: Any, z: Any, active: Any, out: Any, first: int, last: int) -> None:
    """Write incoming light into the rows `first` to `last` - 1 of `out`, (h, w, C), lengths in cells."""
    rows, columns, channels = light.shape
    for i in range(first, last):
        for j in range(columns):
            up = 1.0 / np.sqrt(1.0 + p[i, j] * p[i, j] + q[i, j] * q[i, j])
            n0, n1 = -p[i, j] * up, -q[i, j] * up
            for a in range(rows):
                for b in range(columns):
                    if not (active[i, j] or active[a, b]):
                        continue
                    across, down, rise = float(b - j), float(a - i), z[a, b] - z[i, j]
                    received = n0 * across + n1 * down + up * rise
                    if received <= 0.0:
                        continue
                    sent = p[a, b] * across + q[a, b] * down - rise
                    if sent <= 0.0:
                        continue
                    square = across * across + down * down + rise * rise + 0.25
                    factor = received * sent / (np.pi * square * square)
                    for channel in range(channels):
                        out[i, j, channel] += light[a, b, channel] * factor
