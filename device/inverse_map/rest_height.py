"""Height of skin at rest, which is zero: what a height map shows there is error, and continues smoothly beside it.

Slopes of the free skin around an object do not close, and integration spreads what does not close over the field.
Connected calm cells rest at one height: their height against the mean of those at rest is error, which is continued
over the rest of the field as a solution of Laplace's equation would. Parts that no calm cells connect, such as the two
sides of a step, keep their distance.
"""

from __future__ import annotations

import cv2
import numpy as np

from device.inverse_map.skin_at_rest import CALM, RESTING
from device.surface import Float32Array, MaskArray


def rest_height(height: Float32Array, kept: Float32Array, lit: MaskArray) -> Float32Array:
    """Return what to subtract from heights in cells, so that skin at rest is level and zero on its largest part.

    Float32 array of shape (h, w), 0 where no height at rest is known; bilinear between the middles of cells.

    height : float32 array of shape (H, W), NaN where invalid
    kept, lit : float32 and bool array of shape (h, w), as of `RestEvidence`; of cells that are not lit nothing is known
    """
    means, known = _mean_heights(height, (kept.shape[0], kept.shape[1]))
    resting = known & lit & (kept < RESTING)
    if not resting.any():
        return np.zeros_like(means)
    parts, labels = cv2.connectedComponents((lit & (kept < CALM)).astype(np.uint8), connectivity=4)
    labels[~resting] = 0
    sizes = np.bincount(labels.ravel(), minlength=parts)
    levels = np.bincount(labels.ravel(), means.ravel(), minlength=parts) / np.maximum(sizes, 1)
    error = np.where(resting, means - levels.astype(np.float32)[labels], np.float32(0.0))
    return _continued(error, resting.astype(np.float32)) + np.float32(levels[1 + int(sizes[1:].argmax())])


def enlarged(cells: Float32Array, shape: tuple[int, ...]) -> Float32Array:
    """Return cells over the field at each of its pixels, float32 array of `shape` (H, W)."""
    return np.asarray(cv2.resize(cells, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def _mean_heights(height: Float32Array, shape: tuple[int, int]) -> tuple[Float32Array, MaskArray]:
    """Return mean heights of cells, arrays of `shape` (h, w), and whether they are known for the most part."""
    means = np.asarray(cv2.resize(height, shape[::-1], interpolation=cv2.INTER_AREA), np.float32)
    if np.isfinite(means).all():
        return means, np.ones(shape, np.bool_)
    valid = np.isfinite(height)
    share = np.asarray(cv2.resize(valid.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA), np.float32)
    total = cv2.resize(np.where(valid, height, np.float32(0.0)), shape[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(total / np.maximum(share, np.float32(1e-6)), np.float32), share > 0.5


def _continued(values: Float32Array, known: Float32Array) -> Float32Array:
    """Return values (h, w) that continue smoothly from where they are known; `known` is their weight, 0 to 1.

    Means over ever coarser cells fill what is not known.
    """
    if min(values.shape) < 2:
        return np.full_like(values, (values * known).sum() / max(float(known.sum()), 1e-9))
    size = ((values.shape[1] + 1) // 2, (values.shape[0] + 1) // 2)
    weight = np.asarray(cv2.resize(known, size, interpolation=cv2.INTER_AREA), np.float32)
    mean = cv2.resize(values * known, size, interpolation=cv2.INTER_AREA) / np.maximum(weight, np.float32(1e-6))
    coarser = _continued(np.asarray(mean, np.float32), np.minimum(np.float32(2.0) * weight, np.float32(1.0)))
    wide = cv2.resize(coarser, values.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(known * values + (np.float32(1.0) - known) * wide, np.float32)
