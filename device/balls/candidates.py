"""Places in a press where the skin may wrap a ball.

Near the apex of a ball every light draws a ramp, and three lights draw ramps in different directions: a patch is a
candidate where the weaker of two independent ramps is strong beside what both leave of its deviation from the flat
skin. This holds for any three lights and any skin, so that no reflectance model is needed yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array, Float64Array

PATCH: Final = 0.45
"""Radius of the patch that is fitted, share of the ball's radius."""

MIN_SCORE: Final = 0.35
"""How much a second ramp must explain, beside what two ramps leave, for a patch to be looked at."""

NOISE_MARGIN: Final = 8.0
"""Ramps weaker than this many times the frame's median ramp energy lose half of their score."""


@dataclass(frozen=True, slots=True, eq=False)
class ReducedIntensity:
    """An intensity image reduced by area, so that a ball spans few pixels.

    deviation : float32 array of shape (h, w, 3), intensity less 1
    weight : float32 array of shape (h, w), share of valid pixels under each reduced pixel
    columns_per_pixel, rows_per_pixel : full-size pixels that one reduced pixel spans
    """

    deviation: Float32Array
    weight: Float32Array
    columns_per_pixel: float
    rows_per_pixel: float

    def to_full(self, column: float, row: float) -> tuple[float, float]:
        """Full-size (column, row) of a reduced position."""
        return (column + 0.5) * self.columns_per_pixel - 0.5, (row + 0.5) * self.rows_per_pixel - 0.5

    def from_full(self, column: float, row: float) -> tuple[float, float]:
        """Reduced (column, row) of a full-size position."""
        return (column + 0.5) / self.columns_per_pixel - 0.5, (row + 0.5) / self.rows_per_pixel - 0.5


@dataclass(frozen=True, slots=True)
class Candidate:
    """A place to look at: full-size position and score, how well two ramps explain the deviation."""

    column: float
    row: float
    score: float


def reduce_intensity(image: NormalizedImage, factor: float) -> ReducedIntensity:
    """The image reduced by about `factor` (no enlargement), invalid pixels weighed zero."""
    rows, columns = image.shape
    factor = max(factor, 1.0)
    size = (max(round(columns / factor), 1), max(round(rows / factor), 1))
    values = cv2.resize(image.values, size, interpolation=cv2.INTER_AREA)
    weight = cv2.resize(image.valid.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    deviation = np.nan_to_num(values - np.float32(1.0), nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
    return ReducedIntensity(deviation, np.asarray(weight, np.float32), columns / size[0], rows / size[1])


def find_candidates(reduced: ReducedIntensity, radius_px: float) -> list[Candidate]:
    """Candidates, best first, at least one `radius_px` (in reduced pixels) apart."""
    score = _ramp_score(reduced.deviation, radius_px)
    reach = max(int(radius_px), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    rows, columns = np.nonzero((score >= cv2.dilate(score, disc)) & (score > MIN_SCORE))
    places = [
        Candidate(*reduced.to_full(float(c), float(r)), float(score[r, c])) for r, c in zip(rows, columns, strict=True)
    ]
    return sorted(places, key=lambda place: -place.score)


def _ramp_score(deviation: Float32Array, radius_px: float) -> Float32Array:
    """How well ramps in two independent directions explain each patch's deviation, 0 to 1, shape (h, w)."""
    basis, disc = _patch_basis(PATCH * radius_px)
    area = float(disc.sum())
    gram: Float64Array = np.einsum("kyx,lyx,yx->kl", basis, basis, disc)
    inverse = np.linalg.inv(gram)
    ramps, rest = [], np.zeros(deviation.shape[:2])
    for channel in range(3):
        plane = np.ascontiguousarray(deviation[..., channel])
        moments = np.stack([_correlate(plane, kernel * disc) for kernel in basis])
        fit = np.einsum("kl,lyx->kyx", inverse, moments)
        energy = _correlate(plane * plane, disc)
        rest += np.maximum(energy - (moments * fit).sum(axis=0), 0.0) / area
        rest += (fit[0] + 0.25 * (fit[3] + fit[5])) ** 2
        ramps.append(fit[1:3])
    slopes = np.stack(ramps)
    across, down = (slopes[:, 0] ** 2).sum(axis=0), (slopes[:, 1] ** 2).sum(axis=0)
    both = (slopes[:, 0] * slopes[:, 1]).sum(axis=0)
    weaker = 0.5 * (across + down) - np.hypot(0.5 * (across - down), both)
    floor = NOISE_MARGIN * float(np.median(0.25 * (across + down))) + 1e-9
    # The stronger ramp does not count against the weaker: beside a near light it may be many times as strong.
    explained = 0.5 * weaker
    return np.asarray(explained / (explained + rest + floor), np.float32)


def _patch_basis(radius_px: float) -> tuple[Float64Array, Float64Array]:
    """Polynomials 1, x, y, x², xy, y² of shape (6, k, k) in units of the radius, and the soft disc of shape (k, k)."""
    reach = int(np.ceil(radius_px + 0.5))
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1] / radius_px
    disc = np.clip((1.0 - np.hypot(row, column)) * radius_px + 0.5, 0.0, 1.0)
    basis = np.stack([np.ones_like(row), column, row, column**2, column * row, row**2])
    return basis, disc


def _correlate(plane: Float32Array, kernel: Float64Array) -> Float64Array:
    """Correlation with a small kernel, borders repeated, float64 array of the plane's shape."""
    found = cv2.filter2D(plane, cv2.CV_32F, kernel.astype(np.float32), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float64)
