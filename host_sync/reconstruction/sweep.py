"""One pass over a level: prolong, smooth, residual and restrict, row after row while the rows are in cache.

Stage s of a row needs stage s - 1 of the rows above and below it, so the stages follow each other down the image, one
row apart. A level is read and written once, however many sweeps are made. Bands of rows work side by side; each
repeats the few rows beyond its borders that it needs, with the same arithmetic, so that the result is the same for
any number of bands and threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from device.surface import Float32Array
from host_sync.reconstruction.grid_level import GridLevel
from host_sync.reconstruction.smoother import (
    inverse_diagonal,
    relax_row,
    residual_row,
    unit_relax_row,
    unit_residual_row,
)
from host_sync.reconstruction.transfer import copy_row, prolong_row, prolong_weighted_row, restrict_row


def sweep(
    level: GridLevel,
    steps: Float32Array,
    z_in: Float32Array | None,
    z_out: Float32Array,
    coarse: Float32Array | None = None,
    coarse_rhs: Float32Array | None = None,
) -> float:
    """Root mean square, in pixels, of the residual where it is restricted, else of the heights written.

    steps : float32 array of shape (sweeps,), relaxation factors
    z_in : heights to start from; None for nought
    z_out : receives the smoothed heights; another array than `z_in`
    coarse : heights of the next level, interpolated and added before smoothing; None for nothing
    coarse_rhs : receives the restricted residual; None where it is not wanted
    """
    nothing = np.empty((0, 0), np.float32)
    squares = np.zeros(level.shape[0])
    arguments = (
        nothing if z_in is None else z_in,
        nothing if coarse is None else coarse,
        level.rhs,
        level.across,
        level.down,
        steps,
        z_out,
        nothing if coarse_rhs is None else coarse_rhs,
        squares,
    )
    bands = level.bands
    if bands == 1:
        _band(*arguments, 0, level.shape[0])
    else:
        _bands(*arguments, bands)
    return float(np.sqrt(squares.sum() / z_out.size))


@njit(cache=True, parallel=True)
def _bands(
    z_in: Any, coarse: Any, rhs: Any, across: Any, down: Any, steps: Any, z_out: Any, coarse_rhs: Any, squares: Any,
    bands: int,
) -> None:  # fmt: skip
    """Work on bands of rows side by side; they begin at even rows, so that each coarse row has one writer."""
    pairs = (z_out.shape[0] + 1) // 2
    for band in prange(bands):
        first, last = 2 * (band * pairs // bands), min(2 * ((band + 1) * pairs // bands), z_out.shape[0])
        _band(z_in, coarse, rhs, across, down, steps, z_out, coarse_rhs, squares, first, last)


@njit(cache=True)
def _band(
    z_in: Any, coarse: Any, rhs: Any, across: Any, down: Any, steps: Any, z_out: Any, coarse_rhs: Any, squares: Any,
    first: int, last: int,
) -> None:  # fmt: skip
    """Pass over the rows `first` to `last` - 1."""
    rows, columns = z_out.shape
    sweeps = steps.size
    restricts = coarse_rhs.size > 0
    halo = sweeps + (1 if restricts else 0)
    stages = np.zeros((sweeps + 1, 4, columns + 2), np.float32)
    inverse = np.zeros((sweeps + 1, columns), np.float32)
    residual = np.zeros(columns, np.float32)
    for t in range(max(first - halo, 0), last + halo + sweeps + 1):
        if t < min(last + halo, rows):
            _start_row(z_in, coarse, across, down, t, stages[0, t % 4])
            if across is not None:
                inverse_diagonal(across[t], down[t], down[t + 1], inverse[t % (sweeps + 1)])
        for s in range(1, sweeps + 1):
            r, margin = t - s, halo - s
            if max(first - margin, 0) <= r < min(last + margin, rows):
                _relax(stages[s - 1], rhs, across, down, inverse, steps[s - 1], r, stages[s, r % 4])
                if s == sweeps and first <= r < last:
                    copy_row(stages[s, r % 4], 1, z_out[r], 0, columns)
                    if not restricts:
                        squares[r] = _square_sum(z_out[r])
        r = t - sweeps - 1
        if restricts and first <= r < last:
            _residual(stages[sweeps], rhs, across, down, r, residual)
            restrict_row(residual, r % 2 == 1, coarse_rhs[r // 2])
            squares[r] = _square_sum(residual)


@njit(cache=True)
def _start_row(z_in: Any, coarse: Any, across: Any, down: Any, r: int, out: Any) -> None:
    """Write row `r` before smoothing, padding included."""
    columns = out.size - 2
    if z_in.size > 0:
        copy_row(z_in[r], 0, out, 1, columns)
    else:
        for c in range(out.size):
            out[c] = np.float32(0.0)
    if coarse.size > 0:
        near = r // 2
        far = min(max(near + 2 * (r % 2) - 1, 0), coarse.shape[0] - 1)
        if across is None:
            prolong_row(coarse[near], coarse[far], out)
        else:
            prolong_weighted_row(coarse[near], coarse[far], across[r], down[r + r % 2], out)
    out[0], out[columns + 1] = out[1], out[columns]


@njit(cache=True)
def _relax(z: Any, rhs: Any, across: Any, down: Any, inverse: Any, step: Any, r: int, out: Any) -> None:
    """Write row `r` of the next stage from the rows of ring `z`, padding included."""
    rows, columns = rhs.shape
    up, low = max(r - 1, 0), min(r + 1, rows - 1)
    if across is None:
        unit_relax_row(z[up % 4], z[r % 4], z[low % 4], rhs[r], low - up, step, out)
    else:
        weight = inverse[r % inverse.shape[0]]
        relax_row(z[up % 4], z[r % 4], z[low % 4], rhs[r], across[r], down[r], down[r + 1], weight, step, out)
    out[0], out[columns + 1] = out[1], out[columns]


@njit(cache=True)
def _residual(z: Any, rhs: Any, across: Any, down: Any, r: int, out: Any) -> None:
    """Write row `r` of the residual from the rows of ring `z`."""
    up, low = max(r - 1, 0), min(r + 1, rhs.shape[0] - 1)
    if across is None:
        unit_residual_row(z[up % 4], z[r % 4], z[low % 4], rhs[r], out)
    else:
        residual_row(z[up % 4], z[r % 4], z[low % 4], rhs[r], across[r], down[r], down[r + 1], out)


@njit(cache=True, fastmath={"reassoc", "contract"})
def _square_sum(row: Any) -> Any:
    """Sum of a row's squares; only this figure for the report may be summed in lanes."""
    total = np.float32(0.0)
    for value in row:
        total += value * value
    return total
