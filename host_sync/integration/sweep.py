"""One pass over a level: interpolate, smooth, restrict the residual, row by row while the rows are in cache.

Stage s of a row needs stage s - 1 of the rows above and below it, so the stages follow each other down the image, one
row apart. A level is read and written once, whatever the number of sweeps; the edges of the finest level are built on
the way (`matrix_free_rows`). Bands of rows run in parallel. Each repeats the few rows beyond its borders that it needs,
with the same arithmetic, so the result does not depend on the number of bands or threads.

Rows of heights are kept in ring buffers of padded rows, row r at index r mod length. Edges and right-hand sides are
kept in ring buffers too, or in the level's own arrays, which act as a ring of full length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from device.surface import Float32Array
from host_sync.integration.levels import FineLevel, GridLevel
from host_sync.integration.matrix_free_rows import advance_edges, begin_edges, load_or_build_row, offset_rows, ring
from host_sync.integration.smoother import (
    relax_row,
    residual_row,
    scale_row,
    square_difference,
    square_sum,
    unit_relax_row,
    unit_residual_row,
    unit_scale_row,
)
from host_sync.integration.transfer import add_cells, copy_row, prolong_row, prolong_weighted_row, restrict_row
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

SLOPES: Final = 4
"""Ring length of slopes built on the way without weights; later stages do not read them."""

SAMPLE_STRIDE: Final = 5
"""On a large level, one row in this many is sampled for changes and corrections. Odd, so that a pattern made by 2:1
coarsening cannot lie in all or none of the sampled rows."""

LARGE_PX: Final = 1 << 21
"""Levels with fewer pixels are sampled in every row."""


@dataclass(frozen=True, slots=True)
class SweepNorms:
    """Root mean squares over the level, pixels.

    residual : of the restricted residual; 0 where none was restricted
    change : of the change by smoothing, over the sampled rows
    """

    residual: float
    change: float


class Task(NamedTuple):
    """Arrays that one pass reads and writes besides the level; members as in `sweep`, empty arrays instead of None."""

    steps: Any
    z_in: Any
    coarse: Any
    nested: bool
    z_out: Any
    coarse_rhs: Any
    squares: Any


NOTHING: Final = np.empty((0, 0), np.float32)
NO_SQUARES: Final = np.empty((2, 0))
UNKNOWN: Final = SweepNorms(0.0, 0.0)


def sweep(
    level: GridLevel | FineLevel,
    steps: Float32Array,
    z_in: Float32Array | None,
    z_out: Float32Array,
    *,
    coarse: Float32Array | None = None,
    nested: bool = False,
    coarse_rhs: Float32Array | None = None,
    measured: bool = False,
) -> SweepNorms:
    """Run one pass; returns its norms, zero unless `measured`.

    steps : float32 array of shape (sweeps,), relaxation factors
    z_in : heights to start from, or the prolongation offsets of a level with weights; None for zero, and for offsets
        that the pass builds itself (pixels and levels without weights)
    z_out : receives the smoothed heights; must not be `z_in`
    coarse : heights of the next level, added before smoothing; None for nothing
    nested : the coarse heights are those of whole cells, to which offsets are added, instead of a correction
    coarse_rhs : receives the restricted residual; None where it is not wanted
    """
    rows, columns = z_out.shape
    squares = np.zeros((2, rows)) if measured else NO_SQUARES
    source: tuple[Any, ...]
    if isinstance(level, FineLevel):
        source = (level.p, level.q, level.weight, level.scale, level.rule, *(None,) * 5)
    elif nested and level.weight_x is None:
        rhs = None if coarse_rhs is None else level.rhs
        source = (*(None,) * 5, rhs, None, None, level.slope_x, level.slope_y)
    else:
        source = (*(None,) * 5, level.rhs, level.weight_x, level.weight_y, None, None)
    task = Task(
        steps,
        NOTHING if z_in is None else z_in,
        NOTHING if coarse is None else coarse,
        nested,
        z_out,
        NOTHING if coarse_rhs is None else coarse_rhs,
        squares,
    )
    parallel_rows(_band, z_out.shape, *source, task)
    if not measured:
        return UNKNOWN
    residual, change = squares.sum(axis=1)
    sampled = len(range(0, rows, row_stride(z_out.size))) * columns
    return SweepNorms(float(np.sqrt(residual / z_out.size)), float(np.sqrt(change / sampled)))


def root_mean_square(values: Float32Array) -> float:
    """Return the root mean square over the sampled rows of a float32 array of shape (H, W)."""
    squares = np.zeros(len(values))
    parallel_rows(_row_squares, values.shape, values, squares)
    sampled = len(range(0, len(values), row_stride(values.size))) * values.shape[1]
    return float(np.sqrt(squares.sum() / sampled))


@njit(cache=True)
def row_stride(pixels: int) -> int:
    """Return the row stride used when sampling a level with this many pixels."""
    return SAMPLE_STRIDE if pixels > LARGE_PX else 1


@njit(cache=True, nogil=True)
def _row_squares(values: Any, squares: Any, first: int, last: int) -> None:
    step = row_stride(values.size)
    for r in range(first + -first % step, last, step):
        squares[r] = square_sum(values[r])


@njit(cache=True, nogil=True)
def _band(
    p: Any, q: Any, weight: Any, scale: Any, rule: Any, rhs: Any, weight_x: Any, weight_y: Any, slope_x: Any,
    slope_y: Any, task: Any, first: int, last: int,
) -> None:  # fmt: skip
    """Pass over the rows `first` to `last` - 1.

    Arrays of the level stay single arguments: numba drops the branches for None only of arguments, not of members.
    """
    steps, z_in, coarse, nested, z_out, coarse_rhs, squares = task
    rows, columns = z_out.shape
    sweeps, restricts = steps.size, coarse_rhs.size > 0
    halo = sweeps + (1 if restricts else 0)
    height = sweeps + 5
    stages = np.zeros((sweeps + 1, height, columns + 2), np.float32)
    nothing, residual, inner = ring(1, columns + 1)[0], ring(1, columns)[0], slice(1, columns + 1)
    begin, end = max(first - halo, 0) // 2 * 2, min((last + halo + 1) // 2 * 2, rows)
    pixels = None if weight is None else ring(4, columns + 4)
    inverse, with_offsets = ring(height, columns), nested and z_in.size == 0
    from_zero, step = z_in.size == 0 and coarse.size == 0, row_stride(z_out.size)
    if rhs is None:
        rhs = ring(height, columns)
    if p is not None:
        at_hand = SLOPES if weight is None else height
        slope_x, slope_y = ring(at_hand, columns + 1), ring(at_hand, columns)
        if weight is not None:
            weight_x, weight_y = ring(height, columns + 1), ring(height, columns)
        begin_edges(q, weight, scale, rule, begin, pixels, weight_y, slope_y)
    for t in range(begin, last + halo + sweeps + 1):
        if t < end and t % 2 == 0:
            for r in range(t, min(t + 2, end)):
                if p is not None:
                    advance_edges(p, q, weight, scale, rule, r, pixels, weight_x, slope_x, weight_y, slope_y)
                if p is not None or sweeps > 0:
                    load_or_build_row(r, weight_x, slope_x, weight_y, slope_y, rhs, inverse)
            upper, lower = stages[0, t % height], stages[0, (t + 1) % height]
            if with_offsets:
                offset_rows(
                    t, rows, weight_x, slope_x, weight_y, slope_y, nothing, coarse[t // 2], upper[inner], lower[inner]
                )  # fmt: skip
            if not from_zero:
                start_rows(t, rows, z_in, with_offsets, coarse, nested, weight_x, weight_y, upper, lower)
        for s in range(1, sweeps + 1):
            r, margin = t - s, halo - s
            if max(first - margin, 0) <= r < min(last + margin, rows):
                padded, last_stage = stages[s, r % height], s == sweeps and not restricts
                out = z_out[r] if last_stage else padded[inner]
                if s == 1 and from_zero:
                    write_first(rhs, weight_x, inverse, steps[0], r, out)
                else:
                    write_relaxed(stages[s - 1], rhs, weight_x, weight_y, inverse, steps[s - 1], r, rows, out)
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
            write_residual(stages[sweeps], rhs, weight_x, weight_y, r, rows, residual)
            restrict_row(residual, r % 2 == 1, coarse_rhs[r // 2])
            if squares.size > 0:
                squares[0, r] = square_sum(residual)


@njit(cache=True)
def start_rows(
    row: int, rows: int, z_in: Any, begun: bool, coarse: Any, nested: bool, weight_x: Any, weight_y: Any, upper: Any,
    lower: Any,
) -> None:  # fmt: skip
    """Write two rows before smoothing, padding included; `begun`: they hold heights already."""
    columns = upper.size - 2
    for r in range(row, min(row + 2, rows)):
        out = upper if r == row else lower
        if z_in.size > 0:
            copy_row(z_in[r], 0, out, 1, columns)
        elif not begun:
            for c in range(out.size):
                out[c] = np.float32(0.0)
        if coarse.size > 0 and not begun:
            near = r // 2
            far = min(max(near + 2 * (r % 2) - 1, 0), coarse.shape[0] - 1)
            if nested:
                add_cells(coarse[near], out)
            elif weight_x is None:
                prolong_row(coarse[near], coarse[far], out)
            else:
                a, d = r % weight_x.shape[0], (r + r % 2) % weight_y.shape[0]
                prolong_weighted_row(coarse[near], coarse[far], weight_x[a], weight_y[d], out)
        out[0], out[columns + 1] = out[1], out[columns]


@njit(cache=True)
def write_first(rhs: Any, weight_x: Any, inverse: Any, step: Any, r: int, out: Any) -> None:
    """Write row `r` of the first stage where all heights are zero, without padding."""
    b = rhs[r % rhs.shape[0]]
    if weight_x is None:
        unit_scale_row(b, step, out)
    else:
        scale_row(b, inverse[r % inverse.shape[0]], step, out)


@njit(cache=True)
def write_relaxed(
    z: Any, rhs: Any, weight_x: Any, weight_y: Any, inverse: Any, step: Any, r: int, rows: int, out: Any
) -> None:
    """Write row `r` of the next stage from the rows of ring `z`, without padding."""
    n = z.shape[0]
    up, low = max(r - 1, 0), min(r + 1, rows - 1)
    b = rhs[r % rhs.shape[0]]
    if weight_x is None:
        unit_relax_row(z[up % n], z[r % n], z[low % n], b, step, out)
    else:
        m = weight_y.shape[0]
        a, u, d = weight_x[r % weight_x.shape[0]], weight_y[r % m], weight_y[(r + 1) % m]
        relax_row(z[up % n], z[r % n], z[low % n], b, a, u, d, inverse[r % n], step, out)


@njit(cache=True)
def write_residual(z: Any, rhs: Any, weight_x: Any, weight_y: Any, r: int, rows: int, out: Any) -> None:
    """Write row `r` of the residual from the rows of ring `z`."""
    n = z.shape[0]
    up, low = max(r - 1, 0), min(r + 1, rows - 1)
    b = rhs[r % rhs.shape[0]]
    if weight_x is None:
        unit_residual_row(z[up % n], z[r % n], z[low % n], b, out)
    else:
        m = weight_y.shape[0]
        a, u, d = weight_x[r % weight_x.shape[0]], weight_y[r % m], weight_y[(r + 1) % m]
        residual_row(z[up % n], z[r % n], z[low % n], b, a, u, d, out)
