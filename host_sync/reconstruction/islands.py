"""Islands: parts of a field that no edge joins. Slopes say nothing of their relative level, so each has its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from device.surface import Float32Array, Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class Islands:
    """Connected parts.

    count : number of islands
    labels : int32 array of shape (H, W), 1 to `count`, 0 at holes; of shape (0, 0) where one island fills the field
    """

    count: int
    labels: NDArray[np.int32]

    def balance(self, rhs: Float64Array) -> None:
        """Subtract each island's mean from a right-hand side in place: rounding must not leave it unsolvable."""
        if self.labels.size == 0:
            rhs -= rhs.mean()
            return
        flat = self.labels.ravel()
        pixels = np.bincount(flat, minlength=self.count + 1)
        sums = np.bincount(flat, weights=rhs.ravel(), minlength=self.count + 1)
        mean = sums / np.maximum(pixels, 1)
        rhs -= mean[self.labels]


def find_islands(weight: Float32Array | None, holes: int) -> Islands:
    """Parts of the field that are connected through neighbouring pixels.

    weight : float32 array of shape (H, W), nought at holes
    holes : number of them
    """
    if holes == 0 or weight is None:
        return Islands(1, np.empty((0, 0), np.int32))
    count, labels = cv2.connectedComponents((weight > 0.0).view(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return Islands(count - 1, np.asarray(labels, np.int32))


def level_islands(z: Float32Array, weight: Float32Array | None, islands: Islands, scale: float) -> None:
    """Scale z (float32 array of shape (H, W)) in place, each island to weighted mean zero, holes to NaN.

    weight : float32 array of shape (H, W), nought at holes; None where every pixel weighs 1
    scale : factor from the unit of z to the one wanted
    """
    factor = np.float32(scale)
    if weight is None:
        _shift(z, np.float32(_row_sums(z).sum() / z.size), factor)
    elif islands.count == 1:
        moments = _row_moments(z, weight).sum(axis=0)
        _shift_weighted(z, weight, np.float32(moments[0] / moments[1]), factor)
    else:
        moments = _island_moments(z, weight, islands.labels, islands.count + 1)
        mean = np.append(np.nan, moments[1:, 0] / moments[1:, 1])
        _shift_islands(z, islands.labels, mean.astype(np.float32), factor)


@njit(cache=True, parallel=True)
def _row_sums(z: Any) -> Any:
    """Sum of each row."""
    sums = np.zeros(z.shape[0])
    for r in prange(z.shape[0]):
        sums[r] = _row_sum(z[r])
    return sums


@njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _row_sum(z: Any) -> Any:
    total = 0.0
    for c in range(z.size):
        total += z[c]
    return total


@njit(cache=True, parallel=True)
def _row_moments(z: Any, weight: Any) -> Any:
    """Per row Σ w z and Σ w, for a field of one island."""
    moments = np.zeros((z.shape[0], 2))
    for r in prange(z.shape[0]):
        _row_moment(z[r], weight[r], moments[r])
    return moments


@njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _row_moment(z: Any, weight: Any, out: Any) -> None:
    """Write Σ w z and Σ w of one row, summed in lanes."""
    moment, total = 0.0, 0.0
    for c in range(z.size):
        w = np.float64(weight[c]) if weight[c] > np.float32(0.0) else 0.0
        moment += w * z[c]
        total += w
    out[0], out[1] = moment, total


@njit(cache=True)
def _island_moments(z: Any, weight: Any, labels: Any, count: int) -> Any:
    """Per label Σ w z and Σ w."""
    moments = np.zeros((count, 2))
    for r in range(z.shape[0]):
        for c in range(z.shape[1]):
            if labels[r, c] > 0:
                w = np.float64(weight[r, c])
                moments[labels[r, c], 0] += w * z[r, c]
                moments[labels[r, c], 1] += w
    return moments


@njit(cache=True, parallel=True)
def _shift(z: Any, mean: Any, scale: Any) -> None:
    """Write (z - mean) · scale."""
    for r in prange(z.shape[0]):
        for c in range(z.shape[1]):
            z[r, c] = (z[r, c] - mean) * scale


@njit(cache=True, parallel=True)
def _shift_weighted(z: Any, weight: Any, mean: Any, scale: Any) -> None:
    """Write (z - mean) · scale, NaN at holes."""
    for r in prange(z.shape[0]):
        for c in range(z.shape[1]):
            z[r, c] = (z[r, c] - mean) * scale if weight[r, c] > np.float32(0.0) else np.float32(np.nan)


@njit(cache=True, parallel=True)
def _shift_islands(z: Any, labels: Any, mean: Any, scale: Any) -> None:
    """Write (z - mean) · scale, with the mean of each pixel's label."""
    for r in prange(z.shape[0]):
        for c in range(z.shape[1]):
            z[r, c] = (z[r, c] - mean[labels[r, c]]) * scale
