"""Correction of pixels' slopes that is found at the middles of cells: of long waves, so that few places are enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from device.surface.fields import Float32Array, GradientField
from host_sync.kernels.cell_rows import bordered, expanded_at
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

SlopePair = tuple[Float32Array, Float32Array]


@dataclass(frozen=True, slots=True, eq=False)
class CellCorrection:
    """Change of pixels' slopes, at the middles of cells.

    p, q : float32 arrays of shape (h, w), to be added
    sigma_p, sigma_q : float32 arrays of shape (h, w), with sign, by how much slopes are unsure there all at once
    shadow : float32 array of shape (h, w), 0 where every light arrives, 1 where one does not
    cell : pixels along a cell
    weight : of slopes in shadow in the integration, as a share of that of others
    unsure : gives float32 arrays of shape (K, h, w), deviations of slopes p and q whose squares add to a variance, each
        wrong all at once; called once, in the background; None where nothing is known of them
    left_alone : float32 array of shape (h, w), how much slopes are as the map reads them, so that what is not known of
        the map counts: 1 where a pixel is saturated, or the correction does not explain what is seen; else 0
    has_rest : whether some skin may be untouched; False where an object lies under the whole field, as the light shows
    """

    p: Float32Array
    q: Float32Array
    sigma_p: Float32Array
    sigma_q: Float32Array
    shadow: Float32Array
    cell: int
    weight: float
    unsure: Callable[[], SlopePair] | None = None
    left_alone: Float32Array | None = None
    has_rest: bool = True

    def apply(self, gradients: GradientField) -> None:
        """Write corrected slopes and weights over those of a gradient field (H, W)."""
        less = np.float32(self.weight - 1.0) * self.shadow
        planes = bordered(np.stack([self.p, self.q, less]))
        parallel_rows(_apply, gradients.p.shape, planes, self.cell, gradients.p, gradients.q, gradients.weight)

    def sigma(self, size: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
        """Return the standard uncertainties of slopes p and q in shadow, with sign, on a field of `size` (w, h)."""
        p, q = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (self.sigma_p, self.sigma_q))
        return np.asarray(p, np.float32), np.asarray(q, np.float32)


@njit(cache=True, nogil=True)
def _apply(planes: Any, cell: int, p: Any, q: Any, weight: Any, first: int, last: int) -> None:
    """Add the first two planes of cells to slopes, and the third's share of the weight to it, in rows."""
    upper, step = np.empty((len(planes), p.shape[1]), np.float32), np.empty((len(planes), p.shape[1]), np.float32)
    expanded = -1
    for r in range(first, last):
        expanded, share = expanded_at(planes, r, cell, expanded, upper, step)
        for c in range(p.shape[1]):
            p[r, c] += upper[0, c] + share * step[0, c]
            q[r, c] += upper[1, c] + share * step[1, c]
            weight[r, c] += weight[r, c] * (upper[2, c] + share * step[2, c])
