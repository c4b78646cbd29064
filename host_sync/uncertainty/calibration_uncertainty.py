"""Uncertainty of a frame's slopes from its calibration: their change when a fold of its balls is left out of
training.

Each replica of the inverse map was trained without some of the balls. Where the others say as much, all read the same
slopes; where a corner, a colour or a slope was trained on few balls they part. The jackknife makes standard deviations
of that: of K replicas √((K - 1) / K · Σ (read - mean)²). Their differences stretch over an object and over the field as
the calibration's errors do, so that heights feel them in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface.fields import Float32Array
from host_sync.gradients.inverse_map_kernel import evaluate
from host_sync.kernels.planes import as_stored
from host_sync.uncertainty.resolution_uncertainty import unresolved_slope


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
        """This one where `share`, float32 array of shape (h, w), is 0, the other one where it is 1."""
        own = np.float32(1.0) - share
        return CalibrationUncertainty(
            np.concatenate([own * self.p, share * other.p]), np.concatenate([own * self.q, share * other.q])
        )

    def sigma(self, shape: tuple[int, int]) -> Float32Array:
        """Return the standard deviation of either slope, resampled to a field of `shape` (H, W)."""
        square = 0.5 * ((self.p**2).sum(axis=0) + (self.q**2).sum(axis=0))
        return _resampled(np.sqrt(square), shape)

    def with_unresolved(self, p: Float32Array, q: Float32Array) -> Float32Array:
        """Return the same beside what was not resolved of a surface with slopes p and q: float32 array of their
        shape."""
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
