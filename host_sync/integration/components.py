"""Connected components of a field. Slopes do not fix their relative height, so each has its own mean, set to zero.

Pixels are grouped into runs, the unbroken stretches of a row: a few hundred thousand where pixels are millions. Runs of
neighbouring rows that share a column are joined (union-find). A full rectangle of equal weights is one component.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, Float64Array
from host_sync.integration.smoother import REASSOCIATE
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

STRIDE: Final = 32
"""Pixels tested together."""


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """Connected components.

    count : number of components
    first : int64 array of shape (H + 1,), index of the first run of each row
    start, stop : int32 arrays of shape (runs,), first column of a run and the one after its last
    label : int32 array of shape (runs,), component of each run, 0 to `count` - 1
    total : float64 array of shape (runs,), sum of each run's weights
    """

    count: int
    first: NDArray[np.int64]
    start: NDArray[np.int32]
    stop: NDArray[np.int32]
    label: NDArray[np.int32]
    total: Float64Array

    def project_rhs(self, rhs: Float64Array) -> None:
        """Subtract each component's mean from a right-hand side in place, so rounding cannot make it unsolvable."""
        moments = self.moments(rhs, np.ones(rhs.shape, np.float32))
        means = self._means(moments, (self.stop - self.start).astype(np.float64))
        parallel_rows(_shift, rhs.shape, rhs, self.first, self.start, self.stop, means, 0.0)

    def center(self, z: Float32Array, moments: Float64Array) -> None:
        """Give each component of z (float32 array of shape (H, W)) weighted mean zero in place; holes become NaN.

        moments : Σ w z of each run, as `moments` returns them
        """
        means = self._means(moments, self.total).astype(np.float32)
        parallel_rows(_shift, z.shape, z, self.first, self.start, self.stop, means, np.float32(np.nan))

    def moments(self, z: Float32Array | Float64Array, weight: Float32Array) -> Float64Array:
        """Σ w z of each run, float64 array of shape (runs,); z and weight have shape (H, W)."""
        moments = np.empty(self.start.size)
        parallel_rows(_moments, z.shape, z, weight, self.first, self.start, self.stop, moments)
        return moments

    def _means(self, moments: Float64Array, total: Float64Array) -> Float64Array:
        """Return the weighted mean of each run's component, float64 array of shape (runs,)."""
        moment, weight = (np.bincount(self.label, part, self.count) for part in (moments, total))
        return np.asarray((moment / weight)[self.label], np.float64)


def label_components(weight: Float32Array) -> Components:
    """Return components of the pixels with positive weight, connected through their four neighbours."""
    counts = np.zeros(weight.shape[0] + 1, np.int64)
    parallel_rows(_count_runs, weight.shape, weight, counts)
    first = np.cumsum(counts)
    start, stop, total = np.empty(first[-1], np.int32), np.empty(first[-1], np.int32), np.empty(first[-1])
    parallel_rows(_write_runs, weight.shape, weight, first, start, stop, total)
    label, count = _join_runs(first, start, stop)
    return Components(count, first, start, stop, label, total)


@njit(cache=True, nogil=True)
def _count_runs(weight: Any, counts: Any, begin: int, end: int) -> None:
    """Write the number of runs of row r to `counts[r + 1]`."""
    for r in range(begin, end):
        counts[r + 1] = _row_runs(weight[r])


@njit(cache=True)
def _row_runs(row: Any) -> Any:
    """Return the number of pixels with a weight whose left neighbour has none."""
    zero = np.float32(0.0)
    count = np.int32(row[0] > zero)
    for c in range(1, row.size):
        count += np.int32((row[c] > zero) & (not row[c - 1] > zero))
    return count


@njit(cache=True, nogil=True)
def _write_runs(weight: Any, first: Any, start: Any, stop: Any, total: Any, begin: int, end: int) -> None:
    """Write start and stop of each run, and the sum of its weights."""
    for r in range(begin, end):
        _write_row_runs(weight[r], start[first[r] : first[r + 1]], stop[first[r] : first[r + 1]])
        for run in range(first[r], first[r + 1]):
            total[run] = row_sum(weight[r, start[run] : stop[run]])


@njit(cache=True)
def _write_row_runs(row: Any, start: Any, stop: Any) -> None:
    """Write start and stop of the runs of a row; strides that are uniform are skipped."""
    zero, at, inside = np.float32(0.0), 0, False
    for begin in range(0, row.size, STRIDE):
        part = row[begin : begin + STRIDE]
        used = 0
        for c in range(part.size):
            used += int(part[c] > zero)
        if used == (part.size if inside else 0):
            continue
        for c in range(part.size):
            if (part[c] > zero) != inside:
                inside = not inside
                if inside:
                    start[at] = begin + c
                else:
                    stop[at] = begin + c
                    at += 1
    if inside:
        stop[at] = row.size


@njit(cache=True)
def _root(parent: Any, run: int) -> int:
    """Return the representative run of this run's component, with path halving."""
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@njit(cache=True)
def _join_runs(first: Any, start: Any, stop: Any) -> tuple[Any, int]:
    """Return the component of each run, numbered by first appearance, and the number of components."""
    parent = np.arange(start.size)
    for r in range(1, first.size - 1):
        above, here = first[r - 1], first[r]
        while above < first[r] and here < first[r + 1]:
            if start[above] < stop[here] and start[here] < stop[above]:
                a, b = _root(parent, above), _root(parent, here)
                parent[max(a, b)] = min(a, b)
            if stop[above] < stop[here]:
                above += 1
            else:
                here += 1
    label, count = np.empty(start.size, np.int32), 0
    for run in range(start.size):
        root = _root(parent, run)
        if root == run:
            label[run] = count
            count += 1
        else:
            label[run] = label[root]
    return label, count


@njit(cache=True, nogil=True)
def _moments(z: Any, weight: Any, first: Any, start: Any, stop: Any, moments: Any, begin: int, end: int) -> None:
    """Write Σ w z of the runs of each row."""
    for r in range(begin, end):
        row_moments(z[r], weight[r], first[r], first[r + 1], start, stop, moments)


@njit(cache=True)
def row_moments(z: Any, weight: Any, begin: int, end: int, start: Any, stop: Any, moments: Any) -> None:
    """Write Σ w z of the runs `begin` to `end` - 1 of a row."""
    for run in range(begin, end):
        moments[run] = _moment(z[start[run] : stop[run]], weight[start[run] : stop[run]])


@njit(cache=True, fastmath=REASSOCIATE)
def _moment(z: Any, weight: Any) -> Any:
    """Σ w z of one run."""
    total = 0.0
    for c in range(z.size):
        total += np.float64(weight[c]) * z[c]
    return total


@njit(cache=True, fastmath=REASSOCIATE)
def row_sum(values: Any) -> Any:
    """Return the sum of a row or a part of one."""
    total = 0.0
    for c in range(values.size):
        total += values[c]
    return total


@njit(cache=True, nogil=True)
def _shift(z: Any, first: Any, start: Any, stop: Any, mean: Any, hole: Any, begin: int, end: int) -> None:
    """Write z - mean with the mean of each run, `hole` between runs."""
    for r in range(begin, end):
        done = 0
        for run in range(first[r], first[r + 1]):
            z[r, done : start[run]] = hole
            subtract(z[r, start[run] : stop[run]], mean[run])
            done = stop[run]
        z[r, done:] = hole


@njit(cache=True)
def subtract(z: Any, mean: Any) -> None:
    """Subtract a number from every pixel of a row or a part of one."""
    for c in range(z.size):
        z[c] -= mean


def center_rectangle(z: Float32Array) -> None:
    """Give z (float32 array of shape (H, W)) of a full rectangle mean zero in place."""
    parallel_rows(_subtract_rows, z.shape, z, np.float32(_row_sums(z).sum() / z.size))


def center_cells(z: Float32Array, shape: tuple[int, int]) -> None:
    """Give the cells z of a full rectangle of `shape` pixels, in place, mean zero over the pixels.

    Smoothing and prolongation offsets do not change the mean over pixels.
    """
    rows, columns = shape
    of_rows, of_last = 2.0 * _row_sums(z), z[:, -1].astype(np.float64)
    if columns % 2:
        of_rows -= of_last
    pixels = np.full(len(z), 2.0)
    if rows % 2:
        pixels[-1] = 1.0
    parallel_rows(_subtract_rows, z.shape, z, np.float32((of_rows * pixels).sum() / (rows * columns)))


def _row_sums(z: Float32Array) -> Any:
    sums = np.zeros(z.shape[0])
    parallel_rows(_write_row_sums, z.shape, z, sums)
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
