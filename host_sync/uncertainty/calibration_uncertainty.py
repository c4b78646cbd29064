"""Uncertainty of slopes from the calibration: folds without some balls, gains ball by ball, what is not resolved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.gradients.inverse_map_kernel import evaluate
from host_sync.kernels.cell_rows import as_stored
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows


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


# Gains: the fractions by which a map reads gentle and steep slopes too steep or too flat, ball by ball.
#
# A gain moves all of an object at once: height maps of steps, coins and grooves are wrong by it. Balls show which gains
# go together, those of gentle and of steep slopes at one place, and how far they differ from place to place. So every
# ball is one draw of what an object's slopes may be wrong by, and gentle objects do not pay for the rims of balls.
# Balls close by count most: an object in the middle of the field does not pay for a ball in its corner. What differs
# from ball to ball differs over an object, too: a plate as large as three balls is wrong by the mean of what three are.

MIN_PIXELS: Final = 50
"""In a band of tilt, for a ball to determine its gain."""

SECTORS: Final = 4
"""Opposite sectors of a ball count as one: what a centre that is off does to them cancels. How far the sectors differ
shows how well a ball determines its gain."""

NEGLIGIBLE: Final = 1e-6
"""Share of a slope that no height map notices."""

CLOSE_WIDTHS: Final = 0.15
"""Standard deviation, in widths of the field, of the Gaussian by which balls count for a place near them."""

MIN_PLACES: Final = 4
"""Balls from which what is common to all, and what is not, is estimated."""

FAR_WEIGHT: Final = 0.02
"""Smallest weight of a ball, however far it is."""

GENTLE_DEG: Final = 10.0
"""Bands below are one: within single degrees noise and centres weigh more than gains."""


def gains_of_ball(
    slope: Float64Array, truth: Float64Array, inside: MaskArray, bands_deg: Sequence[tuple[float, float]]
) -> tuple[Float64Array, Float64Array]:
    """Return the error of the gain in every band of tilt, and its variance; both float64 arrays of shape (bands,).

    Bands up to `GENTLE_DEG` are read as one. Bands that a ball does not show have the gain of those next to them, NaN
    where it shows none; the variance is NaN where fewer than two sectors show it.

    slope : errors of slopes, float64 array of shape (2, h, w)
    truth : true slopes, likewise
    inside : bool array of shape (h, w), pixels that count
    """
    square, along = (truth**2).sum(axis=0)[inside], (slope * truth).sum(axis=0)[inside]
    p, q = truth[:, inside]
    sector = np.floor((np.arctan2(q, p) % np.pi) * (SECTORS / np.pi)).astype(np.intp) % SECTORS
    gain, variance = np.full(len(bands_deg), np.nan), np.full(len(bands_deg), np.nan)
    for number, band_deg in enumerate(bands_deg):
        low, high = (0.0, GENTLE_DEG) if band_deg[1] <= GENTLE_DEG else band_deg
        rows = (square >= np.tan(np.radians(low)) ** 2) & (square < np.tan(np.radians(min(high, 89.0))) ** 2)
        if rows.sum() < MIN_PIXELS:
            continue
        total, part = (np.bincount(sector[rows], values[rows], SECTORS) for values in (square, along))
        shown = total > 0.0
        gain[number] = part.sum() / total.sum()
        if shown.sum() > 1:
            apart = part[shown] / total[shown] - gain[number]
            variance[number] = (total[shown] / total.sum() * apart**2).sum() / (shown.sum() - 1)
    return _filled(gain), variance


def with_gains(balls: Sequence[tuple[Float64Array, Float64Array]]) -> list[int]:
    """Return numbers of the balls that determine a gain in every band."""
    return [number for number, (gain, _) in enumerate(balls) if np.isfinite(gain).all()]


def believed_gains(balls: Sequence[tuple[Float64Array, Float64Array]]) -> tuple[tuple[float, ...], ...]:
    """Return the gains of balls by band, reduced by what the scatter of their sectors explains.

    Reduced is their mean square; only the balls of `with_gains` are returned. What balls agree on is believed whatever
    their sectors show: those may differ for a reason that all balls have.

    balls : gains and their variances, as of `gains_of_ball`
    """
    known = [balls[number] for number in with_gains(balls)]
    if not known:
        return ()
    gains, variances = (np.stack(part) for part in zip(*known, strict=True))
    square = (gains**2).mean(axis=0)
    known_bands = np.isfinite(variances)
    scatter = np.where(known_bands, variances, 0.0).sum(axis=0) / np.maximum(known_bands.sum(axis=0), 1)
    agreed = 0.0 * square
    if len(gains) > 1:
        agreed = np.maximum(gains.mean(axis=0) ** 2 - gains.var(axis=0, ddof=1) / len(gains), 0.0)
    believed = np.maximum(square - scatter, agreed) / np.maximum(square, 1e-30)
    return tuple(tuple(float(value) for value in row) for row in gains * np.sqrt(np.minimum(believed, 1.0)))


def gain_curves(gains: Sequence[Sequence[float]]) -> Float64Array:
    """Return errors of the gain at the bands' tilts, float64 array of shape (r, bands).

    Their squares add to the balls' mean square, and the gains of balls go together in each. r is 0 where no ball
    determines a gain, and the number of bands at most.
    """
    if not gains:
        return np.zeros((0, 0))
    own = np.array(gains)
    _, size, together = np.linalg.svd(own / np.sqrt(len(own)), full_matrices=False)
    return np.asarray((size[:, None] * together)[size > NEGLIGIBLE])


def shared_and_local(
    gains: Sequence[Sequence[float]], places: Sequence[tuple[float, float]]
) -> tuple[Float64Array, Float64Array]:
    """Return curves as of `gain_curves` of what balls have in common, and of what differs from place to place.

    places : of the balls; without them, or with fewer than `MIN_PLACES`, all counts as common
    """
    if len(places) != len(gains) or len(gains) < MIN_PLACES:
        return gain_curves(gains), np.zeros((0, len(gains[0]) if gains else 0))
    mean = np.array(gains).mean(axis=0)
    return gain_curves([mean.tolist()]), gain_curves((np.array(gains) - mean).tolist())


def local_normals(rng: np.random.Generator, shape: tuple[int, int, int, int]) -> Float32Array:
    """Return random numbers of mean 0 and variance 1 that are alike at places close by.

    Float32 array of `shape`: samples, curves, rows and columns of a reduced field. At every place their mean square
    over the samples is 1.
    """
    samples, curves, rows, columns = shape
    sigma = CLOSE_WIDTHS * columns
    margin = int(np.ceil(2.0 * sigma))
    inner = (slice(margin, margin + rows), slice(margin, margin + columns))
    white = rng.standard_normal((samples, curves, rows + 2 * margin, columns + 2 * margin), dtype=np.float32)
    found = np.empty(shape, np.float32)
    for smooth, noise in zip(found.reshape(-1, rows, columns), white.reshape(-1, *white.shape[2:]), strict=True):
        smooth[:] = cv2.GaussianBlur(noise, (0, 0), sigma)[inner]
    return np.asarray(found / np.sqrt(np.square(found).mean(axis=0)), np.float32)


def gains_by_place(
    gains: Sequence[Sequence[float]], places: Sequence[tuple[float, float]], size: tuple[int, int]
) -> Float32Array:
    """Return the gains of balls close by over those of all balls, float32 array of shape (h, w).

    Both are root mean squares.

    places : of the balls, column and row in widths of the field; without them it is 1 everywhere
    size : of the reduced field, (w, h)
    """
    columns, rows = size
    square = np.square(np.array(gains)).mean(axis=-1) if gains else np.zeros(0)
    if len(places) != len(square) or not square.sum() > 0.0:
        return np.ones((rows, columns), np.float32)
    across, down = (
        np.exp(-0.5 * ((np.arange(count)[:, None] + 0.5) / columns - at) ** 2 / CLOSE_WIDTHS**2)
        for count, at in zip((columns, rows), np.array(places).T, strict=True)
    )
    counts, total = down @ across.T, (down * square) @ across.T
    mean = (total + FAR_WEIGHT * square.sum()) / (counts + FAR_WEIGHT * len(square))
    return np.asarray(np.sqrt(mean / square.mean()), np.float32)


def gain_at(curve: Float64Array, cosine: Float32Array, tilt_deg: Sequence[float]) -> Float32Array:
    """Return a curve of gains (bands,) at tilts whose cosine is `cosine`, in its shape.

    It is linear between the bands' tilts `tilt_deg`, and constant beyond them.
    """
    known = np.cos(np.radians(tilt_deg))
    return np.asarray(np.interp(cosine, known[::-1], curve[::-1]), np.float32)


def _filled(values: NDArray[np.float64]) -> Float64Array:
    known = np.flatnonzero(np.isfinite(values))
    return values if not known.size else np.interp(np.arange(len(values)), known, values[known])
