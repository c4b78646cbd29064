"""Islands: parts of a field that no edge joins. Slopes say nothing of their relative level, so each has its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from device.surface import Float32Array, Float64Array, GradientField


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


def find_islands(gradients: GradientField, holes: int) -> Islands:
    """Parts of the field that are connected through neighbouring pixels; `holes` counts the pixels without a height."""
    if holes == 0:
        return Islands(1, np.empty((0, 0), np.int32))
    used = gradients.valid & (gradients.weight > 0.0)
    count, labels = cv2.connectedComponents(used.astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return Islands(count - 1, np.asarray(labels, np.int32))


def level_islands(z: Float32Array, gradients: GradientField, islands: Islands, scale: float) -> None:
    """Scale z (float32 array of shape (H, W)) in place, each island to weighted mean zero, holes to NaN.

    scale : factor from the unit of z to the one wanted
    """
    weight = np.ascontiguousarray(gradients.weight, np.float32)
    if islands.count == 1:
        moments, totals = _row_moments(z, weight, gradients.valid)
        mean = np.array([np.nan, moments.sum() / totals.sum()])
    else:
        moments, totals = _island_moments(z, weight, islands.labels, islands.count + 1)
        mean = np.append(np.nan, moments[1:] / totals[1:])
    _shift(z, islands.labels, mean.astype(np.float32), np.float32(scale))


@njit(cache=True, parallel=True)
def _row_moments(z: Any, weight: Any, valid: Any) -> tuple[Any, Any]:
    """Per row Σ w z and Σ w over valid pixels, for a field of one island."""
    rows = z.shape[0]
    moments, totals = np.zeros(rows), np.zeros(rows)
    for r in prange(rows):
        moments[r], totals[r] = _row_moment(z[r], weight[r], valid[r])
    return moments, totals


@njit(cache=True, fastmath={"reassoc", "contract"})
def _row_moment(z: Any, weight: Any, valid: Any) -> tuple[Any, Any]:
    """Σ w z and Σ w of one row, summed in lanes."""
    moment, total = 0.0, 0.0
    for c in range(z.size):
        w = np.float64(weight[c]) * valid[c]
        moment += w * z[c]
        total += w
    return moment, total


@njit(cache=True)
def _island_moments(z: Any, weight: Any, labels: Any, count: int) -> tuple[Any, Any]:
    """Per label Σ w z and Σ w."""
    moments, totals = np.zeros(count), np.zeros(count)
    for r in range(z.shape[0]):
        for c in range(z.shape[1]):
            w = np.float64(weight[r, c])
            if labels[r, c] > 0:
                moments[labels[r, c]] += w * z[r, c]
                totals[labels[r, c]] += w
    return moments, totals


@njit(cache=True, parallel=True)
def _shift(z: Any, labels: Any, mean: Any, scale: Any) -> None:
    """Write (z - mean) · scale, with the mean of each pixel's label."""
    for r in prange(z.shape[0]):
        if labels.size > 0:
            for c in range(z.shape[1]):
                z[r, c] = (z[r, c] - mean[labels[r, c]]) * scale
        else:
            for c in range(z.shape[1]):
                z[r, c] = (z[r, c] - mean[1]) * scale
