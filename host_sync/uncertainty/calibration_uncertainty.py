"""Uncertainty of a frame's slopes from its calibration, by leaving folds of its balls out of training.

Each replica of the inverse map was trained without some of the balls. Where the others say as much, all read the same
slopes; where a corner, a colour or a slope was trained on few balls they part. The jackknife makes standard deviations
of that: of K replicas √((K - 1) / K · Σ (read - mean)²). Their differences stretch over an object and over the field as
the calibration's errors do, so that heights feel them in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import Float32Array
from host_sync.gradients.inverse_map_kernel import evaluate
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.kernels.planes import as_stored


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationUncertainty:
    """Slopes' deviations from replica to replica on the reduced field, so scaled that their squares add to a variance.

    p, q : float32 arrays of shape (K, h, w); K is 0 where a calibration has no replicas
    """

    p: Float32Array
    q: Float32Array

    @classmethod
    def of(cls, deviations: tuple[Float32Array, Float32Array], size: tuple[int, int]) -> CalibrationUncertainty:
        """Return deviations (K, n, m) of slopes p and q, resampled to a reduced field of `size` (w, h)."""
        return cls(*(np.stack([_resampled(one, size[::-1]) for one in part]) for part in deviations))

    def mixed_with(self, other: CalibrationUncertainty, share: Float32Array) -> CalibrationUncertainty:
        """Return these deviations where `share` is 0, and the other ones where it is 1.

        share : float32 array of shape (h, w)
        """
        own = np.float32(1.0) - share
        return CalibrationUncertainty(
            np.concatenate([own * self.p, share * other.p]), np.concatenate([own * self.q, share * other.q])
        )

    def sigma(self, shape: tuple[int, int]) -> Float32Array:
        """Return the standard deviation of either slope, resampled to a field of `shape` (H, W)."""
        square = 0.5 * ((self.p**2).sum(axis=0) + (self.q**2).sum(axis=0))
        return _resampled(np.sqrt(square), shape)

    def with_unresolved(self, p: Float32Array, q: Float32Array) -> Float32Array:
        """Return the slope uncertainty with what was not resolved of a surface, in the shape of p and q.

        p, q : slopes of the surface
        """
        unresolved = unresolved_slope(p, q)
        both = np.hypot(unresolved, self.sigma((unresolved.shape[0], unresolved.shape[1])))
        return _resampled(both, (p.shape[0], p.shape[1]))


def _resampled(field: Float32Array, shape: tuple[int, int]) -> Float32Array:
    return np.asarray(cv2.resize(field, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def calibration_uncertainty(
    image: NormalizedImage, replicas: Sequence[InverseMap], size: tuple[int, int]
) -> CalibrationUncertainty:
    """Return the uncertainty of an image's slopes on a reduced field of `size` (w, h)."""
    if not replicas:
        nothing = np.zeros((0, size[1], size[0]), np.float32)
        return CalibrationUncertainty(nothing, nothing)
    values = _shrunk(image.values, size)
    everywhere = np.ones(values.shape[:2], np.bool_)
    small = NormalizedImage(values, everywhere, ~everywhere)
    read = [evaluate(replace(one, shape=small.shape), small) for one in replicas]
    slopes = np.stack([part.p for part in read]), np.stack([part.q for part in read])
    return CalibrationUncertainty(*(jackknifed(part) for part in slopes))


def jackknifed(read: Float32Array) -> Float32Array:
    """Return deviations of what K replicas read, arrays (K, ...), so scaled that their squares add to a variance."""
    return np.asarray(np.float32(np.sqrt((len(read) - 1) / len(read))) * (read - read.mean(axis=0)), np.float32)


def _shrunk(values: Float32Array, size: tuple[int, int]) -> Float32Array:
    """Return colours (H, W, 3) reduced by area to `size` (w, h), as three planes where they are stored so."""
    stored, by_plane = as_stored(values)
    if not by_plane:
        return np.asarray(cv2.resize(stored, size, interpolation=cv2.INTER_AREA), np.float32)
    planes = [cv2.resize(plane, size, interpolation=cv2.INTER_AREA) for plane in stored]
    return np.moveaxis(np.stack(planes).astype(np.float32), 0, -1)


# Uncertainty from the resolution of camera and pipeline: error of slopes where they bend within few pixels.
#
# A blur of standard deviation s takes ½ s² ∇²p from a slope p, to first order: at edges, and of a wave of 10 px a sixth
# of its slope with s = 1 px. The sharpness of a lens is not known, so that this is no correction but an uncertainty.

BLUR_PX: Final = 1.0
"""Standard deviation of everything that blurs: a lens that suits its pixels has 0.5 to 0.6 px, demosaicing, integration
and central differences 0.5 px, and shrinkage of what is near the noise takes as much again."""

CELL_PX: Final = 4
PATCH_CELLS: Final = 1.0
"""Size of a cell, and standard deviation in cells of the patch over which what is lost is averaged."""

REACH: Final = 2
"""Pixels between the points of a second difference: noise from pixel to pixel is no bend."""


def unresolved_slope(p: Float32Array, q: Float32Array) -> Float32Array:
    """Return the standard deviation of either slope that was not resolved, on cells: float32 array of shape (h, w).

    p, q : slopes of the surface, float32 arrays of shape (H, W)
    """
    rows, columns = p.shape
    shape = (-(-rows // CELL_PX), -(-columns // CELL_PX))
    square = np.zeros(shape, np.float32)
    parallel_rows(_write_bends, (shape[0], columns), p, q, square)
    patch = cv2.GaussianBlur(square, (0, 0), PATCH_CELLS)
    return np.asarray(np.float32(0.5 * BLUR_PX**2) * np.sqrt(patch), np.float32)


@njit(cache=True, nogil=True)
def _write_bends(p: Any, q: Any, square: Any, first: int, last: int) -> None:
    """Write the mean square of either slope's Laplacian for the rows `first` to `last` - 1 of cells."""
    rows, columns = p.shape
    line = np.empty(columns, np.float32)
    for i in range(first, last):
        top, bottom = i * CELL_PX, min((i + 1) * CELL_PX, rows)
        line[:] = np.float32(0.0)
        for r in range(top, bottom):
            above, below = max(r - REACH, 0), min(r + REACH, rows - 1)
            _add_bends(p[above], p[r], p[below], line)
            _add_bends(q[above], q[r], q[below], line)
        for j in range(square.shape[1]):
            end = min((j + 1) * CELL_PX, columns)
            total = np.float32(0.0)
            for c in range(j * CELL_PX, end):
                total += line[c]
            square[i, j] = total * np.float32(0.5) / np.float32((bottom - top) * (end - j * CELL_PX))


@njit(cache=True)
def _add_bends(above: Any, here: Any, below: Any, line: Any) -> None:
    """Add the squares of a row's Laplacians; what has a neighbour that is no number counts as straight."""
    per_square = np.float32(1.0 / REACH**2)
    for c in range(REACH, here.size - REACH):
        bend = above[c] + below[c] + here[c - REACH] + here[c + REACH] - np.float32(4.0) * here[c]
        bend *= per_square
        line[c] += bend * bend if bend == bend else np.float32(0.0)
