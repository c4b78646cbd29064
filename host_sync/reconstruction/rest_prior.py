"""The prior that skin rests where light shows no slope, as weights and shrinkage of a frame's slopes.

Slopes of skin at rest are known far better than slopes of touched skin: there the membrane is flat. Between an object
and skin at rest the skin is free. Balls show slopes only where the skin touches them, high above rest, so that slopes
of lower skin are extrapolated in elevation: near lights reach it at another angle, and the object shades it. On seven
real sensors the slopes around a ball do not close (their mean over a ring is up to 0.2), those on it do. Information
therefore rises with elevation, and what does not close is spread over the free skin instead of the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.inverse_map.skin_at_rest import MIN_RESTING, RESTING, RestEvidence
from device.surface.fields import Float32Array, GradientField, MaskArray
from host_sync.integration.integrate import integrate
from host_sync.kernels.parallel_rows import parallel_rows

REST_INFORMATION: Final = 100.0
FREE_INFORMATION: Final = 0.1
"""Weight of a slope of skin at rest and of free skin, relative to that of skin in contact."""

FREE_BELOW: Final = 0.2
CONTACT_ABOVE: Final = 0.6
"""Elevation as a fraction of the highest skin's, up to which skin is free and from which it touches the object."""

HIGHEST_PERCENT: Final = 99.5


@dataclass(frozen=True, slots=True, eq=False)
class RestPrior:
    """Shrinkage and weights of slopes, in cells over the field.

    kept : float32 array of shape (h, w), fraction of a slope that remains
    weight : float32 array of shape (h, w), factor of a slope's weight
    """

    kept: Float32Array
    weight: Float32Array

    @classmethod
    def of(cls, gradients: GradientField, evidence: Sequence[RestEvidence]) -> RestPrior | None:
        """Return the prior of slopes (H, W); None where too little skin is at rest.

        evidence : of each group of lights; skin is at rest where all groups show it
        """
        if not evidence:
            return None
        kept = np.max([one.kept for one in evidence], axis=0)
        resting = kept < RESTING
        if resting.mean() < MIN_RESTING:
            return None
        at_rest = (np.float32(1.0) - kept) ** 4
        sure = np.float32(1.0) + np.float32(REST_INFORMATION - 1.0) * at_rest
        p, q = (kept * _cell_means(slope, gradients.valid, kept.shape) for slope in (gradients.p, gradients.q))
        field = GradientField(p, q, np.ones(kept.shape, np.bool_), sure)
        z = integrate(field, 1.0)[0].z_um
        z -= np.median(z[resting])
        highest = float(np.percentile(z, HIGHEST_PERCENT))
        if highest <= 0.0:
            return cls(kept, sure)
        rise = np.clip((z / highest - FREE_BELOW) / (CONTACT_ABOVE - FREE_BELOW), 0.0, 1.0)
        contact = rise * rise * (3.0 - 2.0 * rise)
        information = np.where(kept < 0.5, 1.0, FREE_INFORMATION + (1.0 - FREE_INFORMATION) * contact)
        return cls(kept, np.asarray(sure * information, np.float32))

    @property
    def resting(self) -> float:
        """Fraction of the field that is at rest."""
        return float((self.kept < RESTING).mean())

    def apply(self, gradients: GradientField) -> None:
        """Shrink and weight slopes (H, W) in place."""
        parallel_rows(self._apply_rows, gradients.p.shape, gradients.p, gradients.q, gradients.weight)

    def at_rest(self, shape: tuple[int, ...]) -> MaskArray:
        """True where skin is at rest: bool array of `shape` (H, W)."""
        return np.asarray(_enlarged(self.kept, shape) < RESTING, np.bool_)

    def _apply_rows(self, p: Float32Array, q: Float32Array, weight: Float32Array, first: int, last: int) -> None:
        """Shrink and weight the rows `first` to `last` - 1."""
        rows = slice(first, last)
        kept, factor = (_rows_of(cells, p.shape, first, last) for cells in (self.kept, self.weight))
        p[rows] *= kept
        q[rows] *= kept
        weight[rows] *= factor


def _cell_means(slope: Float32Array, valid: MaskArray, size: tuple[int, ...]) -> Float32Array:
    """Return the mean slopes of cells, shape `size`, where invalid pixels count as level."""
    known = slope if valid.all() else np.where(valid, slope, np.float32(0.0))
    return np.asarray(cv2.resize(known, size[::-1], interpolation=cv2.INTER_AREA), np.float32)


def _enlarged(cells: Float32Array, shape: tuple[int, ...]) -> Float32Array:
    return np.asarray(cv2.resize(cells, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)


def _rows_of(cells: Float32Array, shape: tuple[int, ...], first: int, last: int) -> Float32Array:
    """Return rows `first` to `last` - 1 of cells enlarged to `shape`, bilinear between the middles of cells."""
    middle = (np.arange(first, last) + 0.5) * (cells.shape[0] / shape[0]) - 0.5
    middle = np.clip(middle, 0.0, cells.shape[0] - 1.0)
    upper = np.minimum(middle.astype(np.intp), max(cells.shape[0] - 2, 0))
    share = (middle - upper).astype(np.float32)[:, None]
    wide = cv2.resize(cells, (shape[1], cells.shape[0]), interpolation=cv2.INTER_LINEAR)
    below = np.minimum(upper + 1, cells.shape[0] - 1)
    return np.asarray(wide[upper] * (np.float32(1.0) - share) + wide[below] * share, np.float32)
