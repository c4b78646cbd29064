"""Uncertainty of slopes by their tilt, and of heights by integrating Monte Carlo samples of the slope errors.

Slope errors are correlated over the field, so that no formula per pixel can give the height's. The samples are levelled
as the height map is: σ is that of the height above untouched skin, which is what the user sees. They are kept, for a
number that is later taken from the height map (a roughness, a step) has an uncertainty only through them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from device.surface import NOISE_KEPT, Float32Array, GradientField, HeightMap, MaskArray, integrate_dct
from host_sync.integration.zero_level import Datum, block_medians
from host_sync.uncertainty.calibration_uncertainty import (
    CalibrationUncertainty,
    gain_at,
    gains_by_place,
    local_normals,
    shared_and_local,
)
from host_sync.uncertainty.kernels import (
    piecewise_linear,
    removed_slope,
    sigma_by_tilt,
    squared_tilt,
    with_scale,
)

if TYPE_CHECKING:
    from host_sync.uncertainty.slope_error import SlopeError

WIDEST_PX: Final = 512
"""Draws are integrated at this size at most: long wavelengths carry nearly all of the height error."""

MIN_WEIGHT: Final = 0.01

NONINTEGRABLE_PX: Final = 8.0
"""Standard deviation of the Gaussian that takes pixel noise out of what integration removed."""

NONINTEGRABLE_CELL_PX: Final = 4
"""The blurs work on cells of so many pixels: half of the narrower one's standard deviation."""

HALF: Final = 0.5
"""A pixel of the reduced field is untouched skin where more than this share of it is."""

SlopePair = tuple[Float32Array, Float32Array]


def nonintegrable_residual(gradients: GradientField, p: Float32Array, q: Float32Array) -> Float32Array:
    """Return the slope error over patches that the non-integrable residual shows, float32 array (H, W).

    It is a standard deviation. Slopes that belong to no surface cannot be right. Of an error without preference
    integration removes half the power and keeps the other half, so that twice of what it removed is the error (p and q
    are the integrated slopes).
    """
    rows, columns = gradients.p.shape
    size = (max(columns // NONINTEGRABLE_CELL_PX, 1), max(rows // NONINTEGRABLE_CELL_PX, 1))
    sigma = NONINTEGRABLE_PX / NONINTEGRABLE_CELL_PX
    total = np.zeros(size[::-1], np.float32)
    for estimated, integrated in ((gradients.p, p), (gradients.q, q)):
        removed = removed_slope(estimated, integrated, gradients.valid)
        total += cv2.GaussianBlur(_shrunk(removed, size), (0, 0), sigma) ** 2
    patches = np.sqrt(cv2.GaussianBlur(total, (0, 0), 4.0 * sigma))
    return np.asarray(cv2.resize(patches, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class HeightUncertainty:
    """Uncertainty of a height map.

    sigma_um : float32 array of shape (H, W), standard uncertainty of the height, µm, NaN where invalid
    samples_um : float32 array of shape (SAMPLES, h, w), Monte Carlo samples of the height error over the same field
        reduced, µm; each levelled as the height map is, scale included
    """

    sigma_um: Float32Array
    samples_um: Float32Array


def reduced_size(shape: tuple[int, ...]) -> tuple[int, int]:
    """(w, h) of the field over which the height errors of a field of `shape` (H, W) are drawn."""
    rows, columns = shape
    factor = max(1, int(np.ceil(columns / WIDEST_PX)))
    return max(columns // factor, 3), max(rows // factor, 3)


def height_draws(
    error: SlopeError, shape: tuple[int, int], calibration: CalibrationUncertainty | None, shadow: SlopePair | None
) -> SlopeDraws:
    """Return the random numbers behind the samples of `height_uncertainty` of a field of `shape` (H, W).

    error, calibration, shadow : as of it
    """
    fields = sum(len(p) for p, _ in _fields_known(calibration, shadow))
    return slope_draws(error, reduced_size(shape), shape[1], fields)


def slope_sigma(
    gradients: GradientField,
    p: Float32Array,
    q: Float32Array,
    nonintegrable: Float32Array,
    error: SlopeError,
    calibration_sigma: Float32Array | None = None,
    noise_kept: float = NOISE_KEPT,
) -> Float32Array:
    """Return the standard uncertainty of either slope of the surface: float32 array of shape (H, W), NaN where invalid.

    p, q : slopes of the height map
    nonintegrable : as `nonintegrable_residual` returns it
    calibration_sigma : of the calibration, float32 array of shape (H, W); None where it is unknown
    noise_kept : share of a pixel's noise that the surface's slopes keep
    """
    cosine = np.cos(np.radians(error.tilt_deg))[::-1]
    pixel, patch = (np.radians(part_deg)[::-1] for part_deg in (error.pixel_deg, error.patch_deg))
    parts = piecewise_linear(cosine, noise_kept * pixel), piecewise_linear(cosine, patch)
    weight = np.maximum(gradients.weight, np.float32(MIN_WEIGHT))
    # Two estimates of one error, by the training balls and by this surface's residual: the larger one counts.
    calibration = np.zeros_like(nonintegrable) if calibration_sigma is None else calibration_sigma
    return sigma_by_tilt((p, q), parts, weight, gradients.valid, nonintegrable, calibration)


def height_uncertainty(
    height: HeightMap,
    gradients: GradientField,
    nonintegrable: Float32Array,
    error: SlopeError,
    datum: Datum,
    scale_share: float = 0.0,
    calibration: CalibrationUncertainty | None = None,
    shadow: SlopePair | None = None,
    draws: SlopeDraws | None = None,
) -> HeightUncertainty:
    """Return the standard uncertainty of the height, and the samples it comes from.

    height : levelled, zero at untouched skin
    nonintegrable : as `nonintegrable_residual` returns it
    datum : what the height map's zero was taken from
    scale_share : standard uncertainty of pixel pitch and ball radius, as a share of the height
    calibration : its own uncertainty, on a field of `reduced_size`; None where it is unknown
    shadow : standard uncertainties of slopes of p and q where a light is hidden, wrong all at once, on a field of
        `reduced_size`; None where none is
    draws : as `height_draws` returns them for this error, `calibration` and `shadow`; None to draw them
    """
    rows, columns = gradients.p.shape
    size = reduced_size(gradients.p.shape)
    reduction = columns / size[0]
    spread = _drawn_spread(gradients, nonintegrable, error, size)
    z_small = _shrunk(_zero_unless(np.isfinite(height.z_um), height.z_um), size)
    seen = _seen(gradients, size)
    square = seen[0] ** 2 + seen[1] ** 2
    # Skin at another elevation than the balls' may be read too steep.
    higher = error.elevation.steeper(z_small / np.float32(height.pitch_um), square)
    cosine = np.float32(1.0) / np.sqrt(np.float32(1.0) + square)
    here = gains_by_place(error.ball_gains, error.ball_places, size)
    everywhere, local = (
        [here * gain_at(curve, cosine, error.tilt_deg) for curve in curves]
        for curves in shared_and_local(error.ball_gains, error.ball_places)
    )
    known = _fields_known(calibration, shadow)
    common = [
        np.concatenate([[gain * slope for gain in (higher, *everywhere)], *(pair[axis] for pair in known)])
        for axis, slope in enumerate(seen)
    ]
    skin = _shrunk(datum.skin, size)
    zero = skin / max(float(skin.sum()), 1e-6)
    if draws is None:
        draws = height_draws(error, gradients.p.shape, calibration, shadow)
    samples_um = np.empty((SAMPLES, *z_small.shape), np.float32)
    for number, sample_um in enumerate(samples_um):
        steeper = _local_gain(local, draws.local[number], size)
        p, q = (
            _slope_draw(draws, (number, axis), spread)
            + np.tensordot(draws.shared[number, 2:], common[axis], axes=1)
            + steeper * slope
            for axis, slope in enumerate(seen)
        )
        sample_um[:] = integrate_dct(p, q, height.pitch_um * reduction)
        sample_um -= np.float32((sample_um * zero).sum())
    zero_um, shared = _unexplained_zero_um(datum, samples_um, skin), draws.shared[:, :2, None, None]
    samples_um += np.float32(zero_um) * shared[:, 0]
    sigma = cv2.resize(np.sqrt((samples_um**2).mean(axis=0)), (columns, rows), interpolation=cv2.INTER_LINEAR)
    samples_um += np.float32(scale_share) * shared[:, 1] * z_small
    return HeightUncertainty(with_scale(sigma, scale_share, height.z_um, gradients.valid), samples_um)


def _local_gain(gains: Sequence[Float32Array], at_places: Float32Array, size: tuple[int, int]) -> Float32Array:
    """Return one draw of the gain that differs from place to place, on a field of `size` (w, h).

    gains : standard uncertainties, arrays of that size
    at_places : a random number for each at every place of a smaller field, shape (K, n, m)
    """
    total = np.zeros(size[::-1], np.float32)
    for gain, at in zip(gains, at_places, strict=True):
        total += gain * cv2.resize(at, size, interpolation=cv2.INTER_LINEAR)
    return total


def _fields_known(calibration: CalibrationUncertainty | None, shadow: SlopePair | None) -> list[SlopePair]:
    """Return fields of slopes p and q, each wrong all at once, as pairs of float32 arrays of shape (n, h, w).

    calibration, shadow : as of `height_uncertainty`
    """
    own = [] if shadow is None else [(shadow[0][None], shadow[1][None])]
    return own if calibration is None else [*own, (calibration.p, calibration.q)]


def _unexplained_zero_um(datum: Datum, samples_um: Float32Array, skin: Float32Array) -> float:
    """Return the standard uncertainty of the zero that the drawn errors leave unexplained, µm.

    Untouched skin is flat: by how much its heights differ, their zero is unknown. Drawn errors of slopes let it differ
    too, and move the object with it: what they account for would count twice.
    """
    if datum.is_relative:
        return datum.zero_sigma_um
    drawn_um = np.concatenate([block_medians(sample_um, skin > HALF) for sample_um in samples_um])
    return datum.zero_sigma_beside_um(float(np.sqrt(np.square(drawn_um).mean())) if drawn_um.size else 0.0)


def _by_tilt(square: Float32Array, error: SlopeError) -> tuple[Float32Array, Float32Array]:
    """Return the pixel and patch part (radians) of the error where p² + q² is `square`."""
    # Looked up by the cosine of the tilt: no arc tangent a pixel.
    cosine = np.float32(1.0) / np.sqrt(np.float32(1.0) + square)
    known = np.cos(np.radians(error.tilt_deg))[::-1]

    def at_tilt(part_deg: tuple[float, ...]) -> Float32Array:
        return np.asarray(np.interp(cosine, known, np.radians(part_deg)[::-1]), np.float32)

    return at_tilt(error.pixel_deg), at_tilt(error.patch_deg)


def _drawn_spread(
    gradients: GradientField, nonintegrable: Float32Array, error: SlopeError, size: tuple[int, int]
) -> SlopePair:
    """Return the standard deviations of a slope's pixel and patch part on the reduced field.

    Independent pixels average out.
    """
    square = _shrunk(squared_tilt(gradients.p, gradients.q, gradients.valid, 9.0), size)
    confidence = _shrunk(np.maximum(gradients.weight, np.float32(MIN_WEIGHT)), size)
    pixel, patch = _by_tilt(square, error)
    growth = (np.float32(1.0) + square) / np.sqrt(confidence)
    reduction = np.float32(gradients.p.shape[1] / size[0])
    patches = np.hypot(patch * growth, _shrunk(nonintegrable, size))
    return np.asarray(pixel * growth / reduction, np.float32), np.asarray(patches, np.float32)


def _seen(gradients: GradientField, size: tuple[int, int]) -> SlopePair:
    """Return slopes on the reduced field, 0 where there are none."""
    p, q = (_shrunk(_zero_unless(gradients.valid, slope), size) for slope in (gradients.p, gradients.q))
    return p, q


def _zero_unless(known: MaskArray, values: Float32Array) -> Float32Array:
    """Return the values, 0 where they are not known."""
    return values if known.all() else np.where(known, values, np.float32(0.0))


def _shrunk(field: Float32Array | MaskArray, size: tuple[int, int]) -> Float32Array:
    return np.asarray(cv2.resize(field.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)


def _slope_draw(draws: SlopeDraws, own: tuple[int, int], spread: SlopePair) -> Float32Array:
    """Return one slope component's error on the reduced field, of a sample and an axis."""
    pixel, patch = spread
    smooth = draws.patches[own] * (patch / max(float(draws.spread[own]), 1e-6))
    return np.asarray(draws.pixels[own] * pixel + smooth, np.float32)


# Random numbers behind the Monte Carlo samples of slope errors.
#
# They do not depend on how large errors are anywhere, so that they can be drawn before slopes are integrated.

SAMPLES: Final = 16

PLACES: Final = 48
"""Places along the field's columns at which gains of slopes are drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class SlopeDraws:
    """Random numbers of mean 0 for every sample of slope errors on a reduced field (h, w).

    shared : of what errs over the whole field at once, float32 array of shape (SAMPLES, count), variance 1
    local : of gains that differ from place to place, float32 array of shape (SAMPLES, K, n, m), variance 1
    pixels : of single pixels, for slopes p and q, float32 array of shape (SAMPLES, 2, h, w), variance 1
    patches : the same over patches, of any variance
    spread : standard deviation of each field of patches, float32 array of shape (SAMPLES, 2)
    """

    shared: Float32Array
    local: Float32Array
    pixels: Float32Array
    patches: Float32Array
    spread: Float32Array


def slope_draws(error: SlopeError, size: tuple[int, int], columns: int, fields: int) -> SlopeDraws:
    """Return the random numbers for a slope error on a reduced field of `size` (w, h).

    They are the same whenever they are drawn, and kept for the next scan of a calibration. Nothing may be written to
    them.

    columns : of the field that was reduced
    fields : how many fields of slopes, each wrong all at once, are known beside what the error says
    """
    everywhere, local = shared_and_local(error.ball_gains, error.ball_places)
    patch_px = max(error.patch_px / (columns / size[0]), 0.5)
    # Beside those fields: elevation, gains everywhere, and the zero and the scale of heights.
    return _drawn(size, fields + len(everywhere) + 3, len(local), patch_px)


@lru_cache(maxsize=1)
def _drawn(size: tuple[int, int], shared_count: int, local_count: int, patch_px: float) -> SlopeDraws:
    """Return numbers that the field of `size` (w, h) shares, and curves that are local in it."""
    rng = np.random.default_rng(0)
    shared = _normals(rng, shared_count)
    places = local_normals(rng, (SAMPLES, local_count, PLACES * size[1] // size[0] + 1, PLACES))
    pixels, patches = (np.empty((SAMPLES, 2, size[1], size[0]), np.float32) for _ in range(2))
    spread = np.empty((SAMPLES, 2), np.float32)
    for own in np.ndindex(spread.shape):
        rng.standard_normal(dtype=np.float32, out=pixels[own])
        patches[own] = cv2.GaussianBlur(rng.standard_normal(size[::-1], dtype=np.float32), (0, 0), patch_px)
        spread[own] = patches[own].std()
    for part in (shared, places, pixels, patches, spread):
        part.flags.writeable = False
    return SlopeDraws(shared, places, pixels, patches, spread)


def _normals(rng: np.random.Generator, count: int) -> Float32Array:
    """Return random numbers for every sample, mean 0 and variance 1: float32 array of shape (SAMPLES, count).

    Over the samples the first SAMPLES - 1 columns have exactly that mean and variance, and no correlation: of what errs
    over the whole field at once, 16 independent draws would give σ to 18 % only.
    """
    normal = rng.standard_normal((SAMPLES, count))
    some = min(count, SAMPLES - 1)
    basis, sizes = np.linalg.qr(np.column_stack([np.ones(SAMPLES), normal[:, :some]]))
    # QR leaves the signs to the library; with those of the sizes every orthogonal set is as likely.
    normal[:, :some] = (basis * np.sign(np.diag(sizes)))[:, 1:] * np.sqrt(SAMPLES)
    return normal.astype(np.float32)
