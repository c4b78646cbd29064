"""The noise of a calibration's frames, and the null colour.

Noise is measured colour against colour and level by level of the wavelet transform. The null colour is the change of
three colours that no slope makes; noise along it is taken out of slopes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.balls.sphere import Ball, BallSamples, pixels_inside
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.inverse_map.regressor import field_position, monomials
from device.surface import Float32Array, Float64Array, slope_from_stereographic, stereographic_from_slope
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
"""Frames from which the noise of each level is estimated."""


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


# The null colour: the change of three colours that no slope makes, and what noise along it does to slopes.
#
# Colours of a surface lie on a surface of their own: two slopes move them in two directions, noise in three. A map that
# was fitted to colours without noise reads slopes in those two directions; what it makes of the third is chance. So
# what shrinkage took out of a pixel is measured along the third direction, and the slope that noise of such a colour
# has on the mean is taken off what is read: the best linear unbiased estimate (Gauss and Markov), of each pixel by
# itself. Detail of the surface has nothing along that direction, and stays.
#
# Both the direction and that slope are polynomials of first degree in stereographic slope and in place. A matt skin's
# direction is one, but for a factor: its colours are linear in the normal.

MAX_BALL_SAMPLES: Final = 12_000
MIN_BALL_SAMPLES: Final = 500
INTENSITY_STEP: Final = 6e-3
"""Of intensity, over which the map's change is taken."""

DETAIL_VARIANCES: Final = (0.01, 0.03, 0.1, 0.3)
"""Variance of either slope of detail that must be read as it is, beside the noise: of 6 degrees, or of more where
`MAX_MISREAD` asks for it."""

MAX_MISREAD: Final = 0.03
"""Root mean square change of slopes without noise, as a share of them."""

TERM_PENALTY: Final = 1e-6
PLACE_PENALTY: Final = 0.01
"""Of terms that change over the field, of -1 to 1: a ball alone does not determine them."""

STEEPEST_PERCENT: Final = 99.0


@dataclass(frozen=True, slots=True, eq=False)
class NullColour:
    """The change of colour that no slope makes, and the noise of slopes that goes with it.

    channels : float32 array of shape (3, 3, 3), by terms of slope, terms of place, and channel: the changes of
        intensity, times these, add up to the residual
    slopes : float32 array of shape (3, 3, 2), likewise: stereographic slope that noise has for every unit of it
    limit : slopes' components beyond it count as this
    """

    channels: Float32Array
    slopes: Float32Array
    limit: float

    def noise(self, u: Float64Array, place: Float64Array, change: Float32Array) -> Float64Array:
        """Return the stereographic slopes (N, 2) that are noise.

        u : float64 array of shape (N, 2), stereographic slopes as read
        place : float64 array of shape (N, 2), position variables
        change : array of shape (N, 3), intensity as seen less intensity with its noise shrunk
        """
        terms = _terms(np.clip(u, -self.limit, self.limit), place)
        residual = ((terms @ self.channels.reshape(-1, 3)) * change).sum(axis=1)
        return np.asarray(residual[:, None] * (terms @ self.slopes.reshape(-1, 2)), np.float64)

    def read(
        self, inverse_map: InverseMap, seen: Float32Array, shrunk: Float32Array, column: Float32Array, row: Float32Array
    ) -> Float64Array:
        """Return slopes of shape (N, 2) of single pixels at full-size coordinates, less the noise.

        seen, shrunk : float32 arrays of shape (N, 3), intensities as seen and with their noise shrunk
        """
        place = field_position(column.astype(np.float64), row.astype(np.float64), inverse_map.shape)
        u = inverse_map.stereographic_of_noisy(seen, place)
        return slope_from_stereographic(u - self.noise(u, place, seen - shrunk), inverse_map.steepest_read)


def learn_null_colour(samples: BallSamples, inverse_map: InverseMap, noise: FrameNoise) -> NullColour | None:
    """Return the null colour of a map for the noise of its frames.

    None where balls show too little, noise is zero, or slopes would change.

    samples : of a calibration's balls, their noise shrunk
    """
    if len(samples.p) < MIN_BALL_SAMPLES:
        return None
    some = samples.select(np.arange(0, len(samples.p), max(1, len(samples.p) // MAX_BALL_SAMPLES)))
    place = field_position(some.column.astype(np.float64), some.row.astype(np.float64), inverse_map.shape)
    u = stereographic_from_slope(some.p.astype(np.float64), some.q.astype(np.float64))
    terms, price = _terms(u, place), _price(u)
    forward = SlopeColour.of(samples, inverse_map.shape).intensity_change(u, place)
    reading = _reading_change(inverse_map, some.intensity, place)
    channels = _unmoved(terms, price, np.cross(forward[..., 0], forward[..., 1]))
    direction = terms @ channels
    # The root's noise as that of intensity: what noise has in common with the residual, and the residual's own power.
    doubled_root = 2.0 * root_of(some.intensity).astype(np.float64)
    common = (direction * doubled_root) @ noise.covariance * doubled_root
    power, read = (direction * common).sum(axis=1), np.einsum("nki,ni->nk", reading, common)
    unit = np.sqrt(power.mean())
    if not unit > 0.0:
        return None
    moved, detail = np.einsum("ni,nik->nk", direction, forward), np.einsum("nki,nij->nkj", reading, forward)
    for variance in DETAIL_VARIANCES:
        weight = power + variance * (moved**2).sum(axis=1)
        gram = (terms * weight[:, None]).T @ terms + np.diag(weight.sum() * price)
        slopes = np.linalg.solve(gram, terms.T @ read)
        misread = (terms @ slopes)[:, :, None] * moved[:, None, :]
        if (misread**2).sum() <= MAX_MISREAD**2 * (detail**2).sum():
            limit = float(np.percentile(np.abs(u).max(axis=1), STEEPEST_PERCENT))
            return NullColour(_by_terms(channels / unit), _by_terms(slopes * unit), limit)
    return None


def _terms(u: Float64Array, place: Float64Array) -> Float64Array:
    """Return terms of slope times terms of place: float64 array of shape (N, 9)."""
    by_slope, by_place = (np.column_stack([np.ones(len(u)), one]) for one in (u, place))
    return np.asarray((by_slope[:, :, None] * by_place[:, None, :]).reshape(len(u), -1))


def _price(u: Float64Array) -> Float64Array:
    """Price of the square of each term's coefficient, beside a sum of squares over samples of mean 1: shape (9,)."""
    square = np.maximum([1.0, *(u**2).mean(axis=0)], 1e-9)
    return np.outer(square, [TERM_PENALTY, PLACE_PENALTY, PLACE_PENALTY]).ravel()


def _by_terms(coefficients: Float64Array) -> Float32Array:
    return np.asarray(coefficients.reshape(3, 3, -1), np.float32)


def _unmoved(terms: Float64Array, price: Float64Array, normal: Float64Array) -> Float64Array:
    """Return coefficients (9, 3) whose sum with terms (N, 9) is along normals (N, 3), however long."""
    from scipy.linalg import eigh  # here, because only calibrating needs it

    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    every = np.kron(terms.T @ terms + len(terms) * np.diag(price), np.eye(3))
    along = (terms[:, :, None] * unit[:, None, :]).reshape(len(terms), -1)
    _, vectors = eigh(every - along.T @ along, every, subset_by_index=(0, 0))
    return np.asarray(vectors[:, 0].reshape(-1, 3))


def _reading_change(inverse_map: InverseMap, intensity: Float32Array, place: Float64Array) -> Float64Array:
    """Change of stereographic slope with intensity that a map reads: float64 array of shape (N, 2, 3)."""
    steps = np.float32(INTENSITY_STEP) * np.eye(3, dtype=np.float32)
    more, less = (
        np.stack([inverse_map.stereographic_at(intensity + sign * step, place) for step in steps], axis=-1)
        for sign in (np.float32(1.0), np.float32(-1.0))
    )
    return np.asarray((more - less) / (2.0 * INTENSITY_STEP))


# Colour of a slope: the root of intensity as a polynomial in slope and place, fitted to a calibration's balls.
#
# The inverse map goes the other way. This one is only as good as it must be to draw a test pattern as the instrument
# would see it; its own errors are the same with and without noise.

SLOPE_DEGREE: Final = 4
PLACE_DEGREE: Final = 1
MAX_SLOPE_SAMPLES: Final = 20_000
SLOPE_STEP: Final = 1e-3
"""Slope over which the colour's change is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class SlopeColour:
    """The fitted colours.

    coefficients : float64 array of shape (terms, 3)
    """

    coefficients: Float64Array

    @classmethod
    def of(cls, samples: BallSamples, shape: tuple[int, int]) -> SlopeColour:
        """Return the colours that samples of balls on a full-size field of `shape` (H, W) show."""
        part = slice(None, None, max(1, len(samples.p) // MAX_SLOPE_SAMPLES))
        place = field_position(samples.column[part].astype(np.float64), samples.row[part].astype(np.float64), shape)
        slope = stereographic_from_slope(samples.p[part].astype(np.float64), samples.q[part].astype(np.float64))
        features = _features(slope, place)
        gram = features.T @ features + TERM_PENALTY * len(features) * np.eye(features.shape[1])
        root = root_of(samples.intensity[part]).astype(np.float64)
        return cls(np.asarray(np.linalg.solve(gram, features.T @ root)))

    def root(self, p: Float64Array, q: Float64Array, place: tuple[float, float]) -> Float32Array:
        """Return the root of intensity (h, w, 3) of slopes (h, w) at one place, two position variables."""
        slope = stereographic_from_slope(p.ravel(), q.ravel())
        features = _features(slope, np.broadcast_to(np.array(place), (p.size, 2)))
        return np.asarray((features @ self.coefficients).reshape(*p.shape, 3), np.float32)

    def change(self, place: tuple[float, float]) -> Float64Array:
        """Change of the root of intensity with either slope of flat skin at a place: float64 array of shape (3, 2)."""
        sides = [
            self.root(np.array([[step * across]]), np.array([[step * (1 - across)]]), place)[0, 0]
            for across in (1, 0)
            for step in (SLOPE_STEP, -SLOPE_STEP)
        ]
        return np.stack([sides[0] - sides[1], sides[2] - sides[3]], axis=-1).astype(np.float64) / (2.0 * SLOPE_STEP)

    def intensity_change(self, u: Float64Array, place: Float64Array) -> Float64Array:
        """Change of intensity with stereographic slope, float64 array of shape (N, 3, 2).

        u, place : float64 arrays of shape (N, 2), stereographic slopes and position variables
        """
        steps = SLOPE_STEP * np.eye(2)
        sides = [[(_features(u + sign * step, place) @ self.coefficients) ** 2 for sign in (1, -1)] for step in steps]
        return np.stack([more - less for more, less in sides], axis=-1) / (2.0 * SLOPE_STEP)


def _features(u: Float64Array, place: Float64Array) -> Float64Array:
    by_slope, by_place = monomials(u, SLOPE_DEGREE), monomials(place, PLACE_DEGREE)
    return np.asarray((by_slope[:, :, None] * by_place[:, None, :]).reshape(len(u), -1))
