"""The weighted least squares as a sparse matrix, built independently of the solver that it checks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix

from device.surface import Float32Array, GradientField


@dataclass(frozen=True, eq=False)
class SparseSystem:
    """A z = b over the pixels that have a height; A is singular: z is determined up to a constant.

    used : bool array of shape (H, W), the pixels in the order of the unknowns
    """

    matrix: csr_matrix
    rhs: NDArray[np.float64]
    used: NDArray[np.bool_]

    def heights(self, solution: NDArray[np.float64]) -> Float32Array:
        """The unknowns as a height map of shape (H, W), px, mean zero, NaN elsewhere."""
        z = np.full(self.used.shape, np.nan, np.float32)
        z[self.used] = solution - solution.mean()
        return z


def sparse_system(gradients: GradientField) -> SparseSystem:
    """Normal equations with two-point edge slopes; an edge weighs the harmonic mean of its pixels' weights."""
    used = gradients.valid & (gradients.weight > 0.0)
    number = np.full(used.shape, -1, np.int64)
    number[used] = np.arange(used.sum())
    parts = [
        _edges(number, gradients.weight, gradients.p, (slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        _edges(number, gradients.weight, gradients.q, (slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ]
    first, second, weight, slope = (np.concatenate([part[i] for part in parts]) for i in range(4))
    count = int(used.sum())
    rhs = np.bincount(second, weight * slope, count) - np.bincount(first, weight * slope, count)
    diagonal = np.bincount(first, weight, count) + np.bincount(second, weight, count)
    entries = np.concatenate([diagonal, -weight, -weight])
    rows = np.concatenate([np.arange(count), first, second])
    columns = np.concatenate([np.arange(count), second, first])
    return SparseSystem(coo_matrix((entries, (rows, columns)), (count, count)).tocsr(), rhs.astype(np.float64), used)


def _edges(
    number: NDArray[np.int64], weight: Float32Array, slope: Float32Array, a: tuple[slice, slice], b: tuple[slice, slice]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Both pixels, weight and slope of every edge between used pixels."""
    joined = (number[a] >= 0) & (number[b] >= 0)
    w_a, w_b = (weight[side][joined].astype(np.float64) for side in (a, b))
    mean = 0.5 * (slope[a][joined].astype(np.float64) + slope[b][joined])
    return number[a][joined], number[b][joined], 2.0 * w_a * w_b / (w_a + w_b), mean
