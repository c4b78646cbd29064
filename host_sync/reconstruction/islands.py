"""Islands: parts of a field that no edge joins. Slopes say nothing of their relative level, so each has its own.

A field is told apart by runs, the unbroken stretches of pixels of a row: a few hundred thousand at most where pixels
are millions. Runs of neighbouring rows that share a column are joined (union-find).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from device.surface import Float32Array, Float64Array
from host_sync.reconstruction.row_bands import in_bands
from host_sync.reconstruction.smoother import IN_LANES

STRIDE: Final = 32
"""Pixels that are looked at together."""


@dataclass(frozen=True, slots=True, eq=False)
class Islands:
    """Connected parts.

    count : number of islands
    first : int64 array of shape (H + 1,), number of the first run of each row
    start, stop : int32 arrays of shape (runs,), first column of a run and the one after its last
    label : int32 array of shape (runs,), island of each run, 0 to `count` - 1
    total : float64 array of shape (runs,), sum of each run's weights
    """

    count: int
    first: NDArray[np.int64]
    start: NDArray[np.int32]
    stop: NDArray[np.int32]
    label: NDArray[np.int32]
    total: Float64Array

    def balance(self, rhs: Float64Array) -> None:
        """Subtract each island's mean from a right-hand side in place: rounding must not leave it unsolvable."""
        moments = self.moments(rhs, np.ones(rhs.shape, np.float32))
        means = self._means(moments, (self.stop - self.start).astype(np.float64))
        in_bands(_shift, rhs.shape, rhs, self.first, self.start, self.stop, means, 0.0)

    def level(self, z: Float32Array, moments: Float64Array) -> None:
        """Bring each island of z (float32 array of shape (H, W)) in place to weighted mean zero, holes to NaN.

        moments : those of z and the weights
        """
        means = self._means(moments, self.total).astype(np.float32)
        in_bands(_shift, z.shape, z, self.first, self.start, self.stop, means, np.float32(np.nan))

    def moments(self, z: Float32Array | Float64Array, weight: Float32Array) -> Float64Array:
        """Σ w z of each run, float64 array of shape (runs,); z and weight have shape (H, W)."""
        moments = np.empty(self.start.size)
        in_bands(_moments, z.shape, z, weight, self.first, self.start, self.stop, moments)
        return moments

    def _means(self, moments: Float64Array, total: Float64Array) -> Float64Array:
        """Weighted mean of each run's island, float64 array of shape (runs,)."""
        moment, weight = (np.bincount(self.label, part, self.count) for part in (moments, total))
        return np.asarray((moment / weight)[self.label], np.float64)


def find_islands(weight: Float32Array) -> Islands:
    """Parts of the field that are connected through neighbouring pixels; `weight` is nought at holes."""
    counts = np.zeros(weight.shape[0] + 1, np.int64)
    in_bands(_count_runs, weight.shape, weight, counts)
    first = np.cumsum(counts)
    start, stop, total = np.empty(first[-1], np.int32), np.empty(first[-1], np.int32), np.empty(first[-1])
    in_bands(_write_runs, weight.shape, weight, first, start, stop, total)
    label, count = _join_runs(first, start, stop)
    return Islands(count, first, start, stop, label, total)


@njit(cache=True, nogil=True)
def _count_runs(weight: Any, counts: Any, begin: int, end: int) -> None:
    """Write the number of runs of each row, behind that of the row before."""
    for r in range(begin, end):
        counts[r + 1] = _row_runs(weight[r])


@njit(cache=True)
def _row_runs(row: Any) -> Any:
    """Number of pixels with a weight that have none before them."""
    nought = np.float32(0.0)
    count = np.int32(row[0] > nought)
    for c in range(1, row.size):
        count += np.int32((row[c] > nought) & (not row[c - 1] > nought))
    return count


@njit(cache=True, nogil=True)
def _write_runs(weight: Any, first: Any, start: Any, stop: Any, total: Any, begin: int, end: int) -> None:
    """Write where each run begins and ends, and the sum of its weights."""
    for r in range(begin, end):
        _write_row_runs(weight[r], start[first[r] : first[r + 1]], stop[first[r] : first[r + 1]])
        for run in range(first[r], first[r + 1]):
            total[run] = row_sum(weight[r, start[run] : stop[run]])


@njit(cache=True)
def _write_row_runs(row: Any, start: Any, stop: Any) -> None:
    """Write where the runs of a row begin and end; strides that are all alike are passed over."""
    nought, at, inside = np.float32(0.0), 0, False
    for begin in range(0, row.size, STRIDE):
        part = row[begin : begin + STRIDE]
        used = 0
        for c in range(part.size):
            used += int(part[c] > nought)
        if used == (part.size if inside else 0):
            continue
        for c in range(part.size):
            if (part[c] > nought) != inside:
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
    """The run that stands for this one's island; paths are halved on the way."""
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@njit(cache=True)
def _join_runs(first: Any, start: Any, stop: Any) -> tuple[Any, int]:
    """Island of each run, in the order of their first runs, and how many islands there are."""
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


@njit(cache=True, fastmath=IN_LANES)
def _moment(z: Any, weight: Any) -> Any:
    """Σ w z of one run."""
    total = 0.0
    for c in range(z.size):
        total += np.float64(weight[c]) * z[c]
    return total


@njit(cache=True, fastmath=IN_LANES)
def row_sum(values: Any) -> Any:
    """Sum of a row, or of a part of one."""
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
    """Take a number from every pixel of a row, or of a part of one."""
    for c in range(z.size):
        z[c] -= mean
