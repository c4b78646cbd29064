"""Gains: the fractions by which a map reads gentle and steep slopes too steep or too flat, ball by ball.

A gain moves all of an object at once: height maps of steps, coins and grooves are wrong by it. Balls show which gains
go together, those of gentle and of steep slopes at one place, and how far they differ from place to place. So every
ball is one draw of what an object's slopes may be wrong by, and gentle objects do not pay for the rims of balls. Balls
close by count most: an object in the middle of the field does not pay for a ball in its corner. What differs from ball
to ball differs over an object, too: a plate as large as three balls is wrong by the mean of what three are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, Float64Array, MaskArray

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
"""Balls that tell what is common to all, and what is not."""

FAR_SHARE: Final = 0.02
"""What a ball counts at least, however far it is."""

GENTLE_DEG: Final = 10.0
"""Bands below are one: of single degrees noise and centres tell more than gains."""


def gains_of_ball(
    slope: Float64Array, truth: Float64Array, inside: MaskArray, bands_deg: Sequence[tuple[float, float]]
) -> tuple[Float64Array, Float64Array]:
    """Return the error of the gain in every band of tilt, and its variance; both float64 arrays of shape (bands,).

    Bands up to `GENTLE_DEG` are read as one. Bands that a ball does not show have the gain of those next to them, NaN
    where it shows none; the variance is NaN where fewer than two sectors tell it.

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
    mean = (total + FAR_SHARE * square.sum()) / (counts + FAR_SHARE * len(square))
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
