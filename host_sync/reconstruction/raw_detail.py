"""The two surfaces of a frame: raw and shrunk detail on the same long waves.

Shrinkage takes noise out of detail, and with it what of the surface is no louder than noise. So roughness is measured
on a second surface: the raw one's fine part on the shrunk one's coarse part. Both are the same where shrinkage does not
reach, so that steps and radii do not depend on which of them is looked at.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, HeightMap
from host_sync.denoising.wavelet_shrinkage import SPLIT_PX
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.results.record import SlopeNoise

CELL_PX: Final = 4
"""The Gaussian works on cells of so many pixels."""


def with_raw_detail(shrunk: HeightMap, raw: HeightMap) -> HeightMap:
    """Return the shrunk surface's long waves with the raw surface's detail; NaN where either has no height."""
    rows, columns = shrunk.z_um.shape
    difference, known = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    parallel_rows(_write_difference, shrunk.z_um.shape, shrunk.z_um, raw.z_um, difference, known)
    size = (max(columns // CELL_PX, 1), max(rows // CELL_PX, 1))
    total, weight = (
        cv2.GaussianBlur(cv2.resize(part, size, interpolation=cv2.INTER_AREA), (0, 0), SPLIT_PX / CELL_PX)
        for part in (difference, known)
    )
    coarse = cv2.resize(total / np.maximum(weight, np.float32(1e-6)), (columns, rows), interpolation=cv2.INTER_LINEAR)
    parallel_rows(_write_sum, shrunk.z_um.shape, shrunk.z_um, difference, known, coarse)
    return HeightMap(difference, shrunk.pitch_um)


def raw_slope_sigma(sigma: Float32Array, p: Float32Array, q: Float32Array, noise: SlopeNoise | None) -> Float32Array:
    """Return the standard uncertainty of the slopes of raw detail: float32 array of shape (H, W), NaN where invalid.

    sigma : the same of the shrunk surface, whose slopes are p and q
    """
    if noise is None:
        return sigma
    square = np.nan_to_num(np.minimum(p * p + q * q, np.float32(9.0)))
    return np.asarray(np.sqrt(sigma * sigma + noise.added_variance(square)), np.float32)


@njit(cache=True, nogil=True)
def _write_difference(
    shrunk: Float32Array, raw: Float32Array, difference: Float32Array, known: Float32Array, first: int, last: int
) -> None:
    for r in range(first, last):
        for c in range(shrunk.shape[1]):
            apart = raw[r, c] - shrunk[r, c]
            finite = np.isfinite(apart)
            difference[r, c] = apart if finite else np.float32(0.0)
            known[r, c] = np.float32(1.0) if finite else np.float32(0.0)


@njit(cache=True, nogil=True)
def _write_sum(
    shrunk: Float32Array, difference: Float32Array, known: Float32Array, coarse: Float32Array, first: int, last: int
) -> None:
    """Write the sum of shrunk heights and fine difference over the difference."""
    for r in range(first, last):
        for c in range(shrunk.shape[1]):
            z_um = shrunk[r, c] + difference[r, c] - coarse[r, c]
            difference[r, c] = z_um if known[r, c] > np.float32(0.0) else np.float32(np.nan)
