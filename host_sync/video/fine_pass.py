"""Passes over every pixel of a frame that is not coarse: few of them, for memory bounds their time."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from device.balls.viewpoint import Viewpoint
from device.surface.fields import Float32Array, GradientField, HeightMap
from host_sync.kernels.cell_rows import bordered, expanded_at
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.reconstruction.perspective import MIN_FACING
from host_sync.video.coarse import CoarseReading

MAX_NEARNESS: Final = 0.1
"""Elevation over the camera's height up to which five terms of a series are exact to single precision."""


class FineCorrection:
    """Change that a coarse reading brings to slopes of a frame of full size, as planes over cells.

    viewpoint : of the camera that sees the slopes; None of one far away
    """

    def __init__(self, reading: CoarseReading, cell: int, viewpoint: Viewpoint | None = None) -> None:
        size = reading.gain_p.shape[::-1]
        kept, factor = np.ones_like(reading.gain_p), reading.weight
        if reading.prior is not None:
            kept, more = (
                np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_LINEAR), np.float32)
                for part in (reading.prior.kept, reading.prior.weight)
            )
            factor = factor * more
        self._planes = bordered(np.stack([reading.gain_p, reading.gain_q, kept, factor]))
        self._cell = cell
        place = (0.0, 0.0, 0.0)
        if viewpoint is not None:
            place = (viewpoint.column, viewpoint.row, 1.0 / viewpoint.height_px)
        self._place = np.array(place, np.float32)

    def apply(self, gradients: GradientField) -> None:
        """Write corrected slopes, as the camera sees them (`seen_slopes`), and weights over those of a field (H, W)."""
        slopes = gradients.p, gradients.q, gradients.weight
        parallel_rows(_apply, gradients.p.shape, self._planes, self._cell, self._place, *slopes)


@njit(cache=True, nogil=True)
def _apply(planes: Any, cell: int, place: Any, p: Any, q: Any, weight: Any, first: int, last: int) -> None:
    """Correct the rows `first` to `last` - 1."""
    upper, step = np.empty((4, p.shape[1]), np.float32), np.empty((4, p.shape[1]), np.float32)
    column, row, nearness = place
    across = np.empty(p.shape[1], np.float32)
    for c in range(across.size):
        across[c] = (np.float32(c) - column) * nearness
    expanded = -1
    for r in range(first, last):
        expanded, share = expanded_at(planes, r, cell, expanded, upper, step)
        _apply_row(upper, step, share, across, (np.float32(r) - row) * nearness, p[r], q[r], weight[r])


@njit(cache=True, error_model="numpy")
def _apply_row(upper: Any, step: Any, share: Any, across: Any, down: Any, p: Any, q: Any, weight: Any) -> None:
    one, least = np.float32(1.0), np.float32(MIN_FACING)
    for c in range(p.size):
        kept = upper[2, c] + share * step[2, c]
        steep = kept * (p[c] + upper[0, c] + share * step[0, c])
        rise = kept * (q[c] + upper[1, c] + share * step[1, c])
        seen = one / max(one + across[c] * steep + down * rise, least)
        p[c] = seen * steep
        q[c] = seen * rise
        weight[c] *= upper[3, c] + share * step[3, c]


def block_moments(values: Float32Array, cell: int, size: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
    """Return means of planes (3, H, W), and of their squares, over `size` (h, w) cells: arrays of shape (3, h, w)."""
    rows, columns = size
    mean, square = np.empty((3, rows, columns), np.float32), np.empty((3, rows, columns), np.float32)
    parallel_rows(_write_moments, (rows, columns * cell**2), values, cell, mean, square)
    return mean, square


@njit(cache=True, nogil=True)
def _write_moments(values: Any, cell: int, mean: Any, square: Any, first: int, last: int) -> None:
    """Fill the rows `first` to `last` - 1 of cells."""
    rows, columns = values.shape[1:]
    total, squares = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for i in range(first, last):
        bottom = min((i + 1) * cell, rows)
        for channel in range(3):
            total[:] = np.float32(0.0)
            squares[:] = np.float32(0.0)
            for r in range(i * cell, bottom):
                _add_row(values[channel, r], total, squares)
            _mean_of_cells(total, cell, bottom - i * cell, mean[channel, i])
            _mean_of_cells(squares, cell, bottom - i * cell, square[channel, i])


@njit(cache=True)
def _add_row(values: Any, total: Any, squares: Any) -> None:
    for c in range(total.size):
        total[c] += values[c]
        squares[c] += values[c] * values[c]


@njit(cache=True)
def _mean_of_cells(total: Any, cell: int, rows: int, mean: Any) -> None:
    for j in range(mean.size):
        right = min((j + 1) * cell, total.size)
        own = np.float32(0.0)
        for c in range(j * cell, right):
            own += total[c]
        mean[j] = own / np.float32(rows * (right - j * cell))


def level(height: HeightMap, zero_um: float, viewpoint: Viewpoint | None = None) -> tuple[float, int]:
    """Write elevations over a zero, as `seen_elevation` has them, over heights; return the largest and their number.

    viewpoint : of the camera that saw the slopes; None of one far away
    """
    z_um = height.z_um
    nearness = 0.0 if viewpoint is None else 1.0 / (viewpoint.height_px * height.pitch_um)
    highest, known = np.empty(len(z_um), np.float32), np.empty(len(z_um), np.int64)
    parallel_rows(_take_zero_off, z_um.shape, z_um, np.float32(zero_um), np.float32(nearness), highest, known)
    return float(highest.max()), int(known.sum())


@njit(cache=True, nogil=True)
def _take_zero_off(z: Any, zero: Any, nearness: Any, highest: Any, known: Any, first: int, last: int) -> None:
    for r in range(first, last):
        highest[r], lowest, known[r] = _take_off(z[r], zero)
        if max(highest[r], -lowest) * nearness > np.float32(MAX_NEARNESS):
            for c in range(z.shape[1]):
                z[r, c] = -np.expm1(-z[r, c] * nearness) / nearness
            highest[r] = -np.expm1(-highest[r] * nearness) / nearness
        elif nearness > np.float32(0.0) and known[r] > 0:
            _elevate_row(z[r], nearness)
            _elevate_row(highest[r : r + 1], nearness)


@njit(cache=True)
def _take_off(z: Any, zero: Any) -> tuple[Any, Any, int]:
    """Take the zero off a row; return its largest and smallest height, and the number of finite ones."""
    highest, lowest, known = np.float32(-np.inf), np.float32(np.inf), 0
    for c in range(z.size):
        over = z[c] - zero
        z[c] = over
        known += np.isfinite(over)
        highest = over if over > highest else highest
        lowest = over if over < lowest else lowest
    return highest, lowest, known


@njit(cache=True)
def _elevate_row(z: Any, nearness: Any) -> None:
    """Write (1 - exp(-z n)) / n over z by its series."""
    one, half, third = np.float32(1.0), np.float32(1.0 / 2.0), np.float32(1.0 / 3.0)
    fourth, fifth = np.float32(1.0 / 4.0), np.float32(1.0 / 5.0)
    for c in range(z.size):
        x = z[c] * nearness
        z[c] *= one - half * x * (one - third * x * (one - fourth * x * (one - fifth * x)))
