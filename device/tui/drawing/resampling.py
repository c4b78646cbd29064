"""Maps and pictures resampled to a terminal's pixels: means over the valid pixels of each area."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array

MIN_VALID: Final = 0.5
"""Minimum valid fraction of an area for a valid mean."""


def fitted_shape(shape: tuple[int, ...], rows: int, columns: int) -> tuple[int, int]:
    """The largest (rows, columns) of cells in which a picture of `shape` (H, W) keeps its proportions.

    A cell is twice as high as wide and holds two square pixels.
    """
    height, width = shape
    scale = min(2.0 * rows / height, columns / width)
    return max(min(round(height * scale / 2.0), rows), 1), max(min(round(width * scale), columns), 1)


def resampled(values: Float32Array, shape: tuple[int, int]) -> Float32Array:
    """A map on another grid: float32 array of `shape` (h, w), NaN where too little was valid."""
    valid = np.isfinite(values)
    size = (shape[1], shape[0])
    method = cv2.INTER_AREA if shape[0] <= values.shape[0] else cv2.INTER_LINEAR
    fraction = cv2.resize(valid.astype(np.float32), size, interpolation=method)
    total = cv2.resize(np.where(valid, values, np.float32(0.0)), size, interpolation=method)
    known = fraction >= MIN_VALID
    mean = np.full(shape, np.nan, np.float32)
    np.divide(total, fraction, out=mean, where=known)
    return mean
