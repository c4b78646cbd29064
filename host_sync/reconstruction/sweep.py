"""One pass over a level: interpolate, smooth, residual and restrict, row after row while the rows are in cache.

Stage s of a row needs stage s - 1 of the rows above and below it, so the stages follow each other down the image, one
row apart. A level is read and written once, however many sweeps are made; the finest level's edges are made on the way
(`level_rows`). Bands of rows work side by side; each repeats the few rows beyond its borders that it needs, with the
same arithmetic, so that the result is the same for any number of bands and threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit

from device.surface import Float32Array
from host_sync.reconstruction.grid_level import GridLevel, PixelField
from host_sync.reconstruction.level_rows import first_edges, next_edges, ring, shape_rows, stored_or_made_row
from host_sync.reconstruction.row_bands import in_bands
from host_sync.reconstruction.smoother import square_difference, square_sum
from host_sync.reconstruction.sweep_stages import start_rows, write_first, write_relaxed, write_residual
from host_sync.reconstruction.transfer import copy_row, restrict_row

SLOPES: Final = 4
"""Rows of slopes at hand where they are made on the way and go with no weights, which later stages read."""

CHANGE_STEP: Final = 5
"""One row in so many of a large level tells how much smoothing changes and how large a correction is; an odd number,
so that no pattern that the 2:1 coarsening makes stands in all of them or in none."""

LARGE_PX: Final = 1 << 21
"""Pixels of such a level; of a smaller one all rows are looked at."""


@dataclass(frozen=True, slots=True)
class SweepFigures:
    """Root mean squares over the level, pixels.

    residual : of the residual that was restricted; nought where none was
    change : of what smoothing changed, in the rows that are looked at
    """

    residual: float
    change: float


NOTHING: Final = np.empty((0, 0), np.float32)
NO_SQUARES: Final = np.empty((2, 0))
UNKNOWN: Final = SweepFigures(0.0, 0.0)


def sweep(
    level: GridLevel | PixelField,
    steps: Float32Array,
    z_in: Float32Array | None,
    z_out: Float32Array,
    *,
    coarse: Float32Array | None = None,
    nested: bool = False,
    coarse_rhs: Float32Array | None = None,
    measured: bool = False,
) -> SweepFigures:
    """What a pass over the level found, noughts unless it is `measured`.

    steps : float32 array of shape (sweeps,), relaxation factors
    z_in : heights to start from, or the shapes of the cells of a level with weights; None for nought, and for shapes
        that the pass makes itself, as it does of pixels and of levels without weights
    z_out : receives the smoothed heights; another array than `z_in`
    coarse : heights of the next level, added before smoothing; None for nothing
    nested : the coarse heights are those of whole cells, to which shapes are added, instead of a correction
    coarse_rhs : receives the restricted residual; None where it is not wanted
    """
    rows, columns = z_out.shape
    squares = np.zeros((2, rows)) if measured else NO_SQUARES
    source: tuple[Any, ...]
    if isinstance(level, PixelField):
        source = (level.p, level.q, level.weight, level.scale, level.rule, *(None,) * 5)
    elif nested and level.across is None:
        rhs = None if coarse_rhs is None else level.rhs
        source = (*(None,) * 5, rhs, None, None, level.slope_across, level.slope_down)
    else:
        source = (*(None,) * 5, level.rhs, level.across, level.down, None, None)
    arguments = (
        *source,
        steps,
        NOTHING if z_in is None else z_in,
        NOTHING if coarse is None else coarse,
        nested,
        z_out,
        NOTHING if coarse_rhs is None else coarse_rhs,
        squares,
    )
    in_bands(_band, z_out.shape, *arguments)
    if not measured:
        return UNKNOWN
    residual, change = squares.sum(axis=1)
    looked_at = len(range(0, rows, rows_apart(z_out.size))) * columns
    return SweepFigures(float(np.sqrt(residual / z_out.size)), float(np.sqrt(change / looked_at)))


def root_mean_square(values: Float32Array) -> float:
    """Root mean square of the rows that are looked at of a float32 array of shape (H, W): enough for an estimate."""
    squares = np.zeros(len(values))
    in_bands(_row_squares, values.shape, values, squares)
    looked_at = len(range(0, len(values), rows_apart(values.size))) * values.shape[1]
    return float(np.sqrt(squares.sum() / looked_at))


@njit(cache=True)
def rows_apart(pixels: int) -> int:
    """How far apart the rows are that are looked at of a level of so many pixels, from its first on."""
    return CHANGE_STEP if pixels > LARGE_PX else 1


@njit(cache=True, nogil=True)
def _row_squares(values: Any, squares: Any, first: int, last: int) -> None:
    step = rows_apart(values.size)
    for r in range(first + -first % step, last, step):
        squares[r] = square_sum(values[r])


@njit(cache=True, nogil=True)
def _band(
    p: Any, q: Any, weight: Any, scale: Any, rule: Any, rhs: Any, across: Any, down: Any, slope_across: Any,
    slope_down: Any, steps: Any, z_in: Any, coarse: Any, nested: bool, z_out: Any, coarse_rhs: Any, squares: Any,
    first: int, last: int,
) -> None:  # fmt: skip
    """Pass over the rows `first` to `last` - 1."""
    rows, columns = z_out.shape
    sweeps, restricts = steps.size, coarse_rhs.size > 0
    halo = sweeps + (1 if restricts else 0)
    height = sweeps + 5
    stages = np.zeros((sweeps + 1, height, columns + 2), np.float32)
    nothing, residual, inner = ring(1, columns + 1)[0], ring(1, columns)[0], slice(1, columns + 1)
    begin, end = max(first - halo, 0) // 2 * 2, min((last + halo + 1) // 2 * 2, rows)
    pixels = None if weight is None else ring(4, columns + 4)
    inverse, shaped = ring(height, columns), nested and z_in.size == 0
    from_nought, step = z_in.size == 0 and coarse.size == 0, rows_apart(z_out.size)
    if rhs is None:
        rhs = ring(height, columns)
    if p is not None:
        at_hand = SLOPES if weight is None else height
        slope_across, slope_down = ring(at_hand, columns + 1), ring(at_hand, columns)
        if weight is not None:
            across, down = ring(height, columns + 1), ring(height, columns)
        first_edges(q, weight, scale, rule, begin, pixels, down, slope_down)
    for t in range(begin, last + halo + sweeps + 1):
        if t < end and t % 2 == 0:
            for r in range(t, min(t + 2, end)):
                if p is not None:
                    next_edges(p, q, weight, scale, rule, r, pixels, across, slope_across, down, slope_down)
                if p is not None or sweeps > 0:
                    stored_or_made_row(r, across, slope_across, down, slope_down, rhs, inverse)
            upper, lower = stages[0, t % height], stages[0, (t + 1) % height]
            if shaped:
                shape_rows(
                    t, rows, across, slope_across, down, slope_down, nothing, coarse[t // 2], upper[inner], lower[inner]
                )  # fmt: skip
            if not from_nought:
                start_rows(t, rows, z_in, shaped, coarse, nested, across, down, upper, lower)
        for s in range(1, sweeps + 1):
            r, margin = t - s, halo - s
            if max(first - margin, 0) <= r < min(last + margin, rows):
                padded, last_stage = stages[s, r % height], s == sweeps and not restricts
                out = z_out[r] if last_stage else padded[inner]
                if s == 1 and from_nought:
                    write_first(rhs, across, inverse, steps[0], r, out)
                else:
                    write_relaxed(stages[s - 1], rhs, across, down, inverse, steps[s - 1], r, rows, out)
                if not last_stage:
                    padded[0], padded[columns + 1] = padded[1], padded[columns]
        r = t - sweeps
        if first <= r < last:
            if sweeps == 0 or restricts:
                copy_row(stages[sweeps, r % height], 1, z_out[r], 0, columns)
            if squares.size > 0 and r % step == 0:
                squares[1, r] = square_difference(z_out[r], stages[0, r % height, inner])
        r = t - sweeps - 1
        if restricts and first <= r < last:
            write_residual(stages[sweeps], rhs, across, down, r, rows, residual)
            restrict_row(residual, r % 2 == 1, coarse_rhs[r // 2])
            if squares.size > 0:
                squares[0, r] = square_sum(residual)
