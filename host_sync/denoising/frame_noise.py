"""The noise of a calibration's frames, colour against colour and level by level of the wavelet transform.

It is learned in the root of intensity from the frames themselves, so that camera noise, demosaicing, compression and
the skin's pigment are all in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.balls.sphere import Ball, pixels_inside
from device.imaging.flat_field import NormalizedImage
from device.surface import Float32Array, Float64Array
from host_sync.denoising.wavelet_shrinkage import HALO_PX, LEVELS, SHARES, Shrinkage, detail_planes

OUTLYING: Final = 11.34
"""Squared distance, in three dimensions, that 1 % of normal noise exceeds: what lies beyond is detail, not noise."""

KEPT_VARIANCE: Final = 0.9525
"""Variance of normal noise of three dimensions cut at `OUTLYING`, as a share of the whole."""

MEDIAN_SQUARE: Final = 2.366
"""Median of the squared length of a normal vector of three dimensions and unit variance."""

ROUNDS: Final = 12
MIN_VARIANCE: Final = 1e-10
"""Of a root of intensity: a hundredth of a count in a thousand. No camera is quieter."""

BALANCING_ROUNDS: Final = 8
MIN_PIXELS: Final = 200
MAX_SAMPLES: Final = 60_000
MAX_FRAMES: Final = 6
"""So many frames tell how noise is spread over the levels."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameNoise:
    """Noise of the root of intensity.

    covariance : float64 array of shape (3, 3), of the finest detail's three colours, its leak included
    ratios : float64 array of shape (3,), variance of each level's detail without its leak, relative to that
    """

    covariance: Float64Array
    ratios: Float64Array

    def whitening(self) -> Float32Array:
        """Float32 array of shape (3, 3, 3): for each level the upper-triangular W with |W d|² / 3 of mean 1."""
        root = np.linalg.cholesky(np.linalg.inv(self.covariance)).T
        return np.stack([root / np.sqrt(ratio) for ratio in self.ratios]).astype(np.float32)

    def shrinkage(self, threshold: Sequence[float], kept: Sequence[float]) -> Shrinkage:
        """Return the shrinkage of this noise; thresholds and shares kept by level."""
        return Shrinkage(self.whitening(), np.array(threshold, np.float32), np.array(kept, np.float32))

    def sample(self, shape: tuple[int, int], rng: np.random.Generator) -> Float32Array:
        """Return the noise of the root of intensity: float32 array of shape (H, W, 3).

        White noise, each level of it so much louder that the sum's own levels have this noise's variance; what is
        smoother than the coarsest is left out.
        """
        around = (shape[0] + 2 * HALO_PX, shape[1] + 2 * HALO_PX, 3)
        details, _ = detail_planes(rng.standard_normal(around).astype(np.float32))
        planes = [detail[HALO_PX:-HALO_PX, HALO_PX:-HALO_PX] for detail in details]
        factor = np.ones(LEVELS)
        for _ in range(BALANCING_ROUNDS):  # levels leak into each other
            shares = (factor * SHARES).astype(np.float32)
            total = np.asarray(sum(share * plane for share, plane in zip(shares, planes, strict=True)))
            own, _ = detail_planes(total)
            factor *= np.sqrt(self.ratios / [float(part.var()) for part in own])
        root = np.linalg.cholesky(self.covariance).astype(np.float32).T
        return np.asarray(total @ root, np.float32)


def measure_noise(
    pressed: Iterable[tuple[NormalizedImage, Sequence[Ball]]], untouched: Sequence[Float32Array]
) -> FrameNoise | None:
    """Return the noise of frames, None where balls show too few pixels.

    pressed : intensity and balls of each press; the finest detail inside their contacts is noise but for a few pixels
    untouched : intensities of shape (H, W, 3) of frames that show untouched skin on most of their area
    """
    parts = [_finest_details(image, ball) for image, balls in pressed for ball in balls]
    found = np.concatenate(parts) if parts else np.zeros((0, 3), np.float32)
    if len(found) < MIN_PIXELS:
        return None
    covariance = robust_covariance(found[:: max(1, len(found) // MAX_SAMPLES)])
    return FrameNoise(covariance, _level_ratios(untouched[:MAX_FRAMES], covariance))


def _finest_details(image: NormalizedImage, ball: Ball) -> Float32Array:
    """Return the finest detail (N, 3) at the faithful pixels inside a ball's contact."""
    row, column = pixels_inside(ball, image.shape)
    known = image.faithful_at((row, column))
    if not known.any():
        return np.zeros((0, 3), np.float32)
    # The next pixels on either side are all that it depends on.
    top, left = (max(int(at.min()) - 1, 0) for at in (row, column))
    window = image.values[top : int(row.max()) + 2, left : int(column.max()) + 2]
    details, _ = detail_planes(root_of(window), levels=1)
    return np.asarray(details[0][row[known] - top, column[known] - left])


def root_of(values: Float32Array) -> Float32Array:
    """Return the root of intensity, of the same shape."""
    return np.sqrt(np.maximum(values, np.float32(0.0)))


def robust_covariance(details: Float32Array) -> Float64Array:
    """Return the covariance (3, 3) of the finest details (N, 3), edges and dust left aside."""
    sample = details.astype(np.float64)
    scale = np.maximum(np.median(np.abs(sample), axis=0) * 1.4826, np.sqrt(MIN_VARIANCE))
    covariance = np.diag(scale**2)
    for _ in range(ROUNDS):
        distance = np.einsum("ni,ij,nj->n", sample, np.linalg.inv(covariance), sample, optimize=True)
        # Half of the sample sets the length, so that a few outliers do not let others in.
        distance *= MEDIAN_SQUARE / max(float(np.median(distance)), 1e-12)
        inside = sample[distance < OUTLYING]
        covariance = inside.T @ inside / (len(inside) * KEPT_VARIANCE) + MIN_VARIANCE * np.eye(3)
    return np.asarray(covariance)


def _level_ratios(images: Sequence[Float32Array], covariance: Float64Array) -> Float64Array:
    """Return the variance of the noise at each level relative to the finest with its leak."""
    whitening = np.linalg.cholesky(np.linalg.inv(covariance)).T.astype(np.float32)
    inner = (slice(HALO_PX, -HALO_PX), slice(HALO_PX, -HALO_PX))
    medians = []
    for image in images:
        root = root_of(image)
        planes = [*detail_planes(root, levels=1)[0], *detail_planes(root)[0]]
        medians.append([float(np.median(((d[inner] @ whitening.T) ** 2).sum(axis=-1))) for d in planes])
    if not medians or not np.isfinite(medians).all():
        return np.ones(LEVELS)
    finest, *level = np.median(np.array(medians), axis=0)
    return np.asarray(np.maximum(level / max(finest, 1e-12), 1e-6))
