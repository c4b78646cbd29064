"""Error of slopes as a function of the surface's tilt, in parts that bend a height map over ever longer distances.

* from pixel to pixel: noise and pigment, which average out
* over a patch: what the map gets wrong of a ball it did not see. Its reach is measured by what it does: slope errors
  added up from a ball's apex to its rim give an error of height, and patches of that reach give the same
* over the whole press: a ball shows each slope at one elevation only, and an object that shows it at another is read
  wrong (see `elevation`)
* over the whole press: slopes read too steep or too flat by a share that goes with their tilt (see
  `calibration_uncertainty.gains_of_ball`), so that heights are off by it; slopes steeper than any ball shows by that of
  balls' rims

Standard deviations are half of the middle 68 % of the errors: few pixels (dust, lifted skin) are wrong without measure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise
from typing import Final, NamedTuple, Protocol

import cv2
import msgspec
import numpy as np

from device.balls.sphere import Ball, BallSamples, sphere_slopes
from device.calibration.cross_validation import angle_between_deg
from device.calibration.fit import MIN_PIXELS as MIN_BAND_PIXELS
from device.calibration.fit import InverseFit, SlopeBand
from device.imaging.flat_field import NormalizedImage
from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.uncertainty.calibration_uncertainty import believed_gains, gains_of_ball, with_gains
from host_sync.uncertainty.elevation import ElevationCorrection

SPLIT_FRACTION: Final = 0.1
"""Standard deviation of the Gaussian that parts pixel from patch, as a share of the contact radius."""

TILT_EDGES_DEG: Final = (0.0, 4.0, 10.0, 20.0, 30.0, 40.0, 50.0, 90.0)
"""Borders of the bands of steepness that have figures of their own."""

ONE_SIGMA_PERCENT: Final = 68.27
INNER_FRACTION: Final = 0.9
"""Share of a contact over which slope errors are added up to errors of height."""

MIN_PIXELS: Final = 50
GENTLE: Final = 0.3
"""Slopes up to which a shift of the centre changes all slopes by nearly the same."""

RAYS: Final = 24
STEPS: Final = 40
SHORTEST_REACH_PX: Final = 1.0

Pressed = Sequence[tuple[NormalizedImage, Sequence[Ball]]]


class SlopeError(msgspec.Struct, frozen=True):
    """Standard deviations of one slope component by tilt of the surface, as angles of the normal.

    In slope they are (1 + p² + q²) times as large.

    tilt_deg : tilt of the surface for which all figures are given; between them they run straight
    pixel_deg : the part that is independent from pixel to pixel
    patch_deg : the part that is the same over a patch
    patch_px : size of such a patch, the standard deviation of a Gaussian
    elevation : at which the balls showed each slope
    ball_gains : share by which slopes are too steep, of every ball at these tilts; none where no ball determines them
    ball_places : of these balls, column and row in widths of the field; none where they were not kept
    """

    tilt_deg: tuple[float, ...]
    pixel_deg: tuple[float, ...]
    patch_deg: tuple[float, ...]
    patch_px: float
    elevation: ElevationCorrection
    ball_gains: tuple[tuple[float, ...], ...]
    ball_places: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _BallError:
    """Slope error (2, h, w) of one ball in its window.

    inside, truth, ball : pixels that count, true slopes (2, h, w), and the ball in the window
    place : centre of the ball, column and row in widths of the field
    """

    slope: Float64Array
    inside: MaskArray
    truth: Float64Array
    ball: Ball
    place: tuple[float, float]


def measure_slope_error(
    presses: Pressed,
    training: BallSamples,
    fit: InverseFit,
    elevation: ElevationCorrection,
    over_cells: OverCells | None,
) -> SlopeError:
    """Return the slope error on the balls of a calibration, whose samples are `training`.

    The map's error on its training balls is scaled up to that on held-out ones, unless the fit's replicas give the
    difference at every pixel. The correction of slopes over cells is judged by balls that it was not fitted to. Gains
    are those of all balls: what they leave open is estimated from the folds in every frame.

    elevation : at which the balls showed each slope
    over_cells : what corrects the map's slopes over cells; None where nothing does
    """
    known = bool(fit.replicas) or over_cells is not None
    errors = list(_ball_errors(presses, lambda _, __: fit.map))
    bands = _by_band(errors)
    if over_cells is not None:
        means = over_cells.means_of(presses)
        rim_px = 0.5 * over_cells.size_px
        errors = list(_ball_errors(means, lambda _, ball: over_cells.reads[ball], rim_px))
        others = list(_ball_errors(means, lambda _, ball: over_cells.without[ball], rim_px))
        bands = _with_patches_of(bands, _by_band(others))
    sums = [_height_errors(error) for error in errors]
    inflation = held_out_inflation(training, fit)
    noise_deg = float(np.mean([pixel for _, pixel, _ in bands]))
    more = 1.0 if known else inflation.throughout(noise_deg)
    gains, places = _gains(errors, [tilt for tilt, _, _ in bands])
    return SlopeError(
        tilt_deg=tuple(tilt for tilt, _, _ in bands),
        pixel_deg=tuple(pixel for _, pixel, _ in bands),
        patch_deg=tuple((1.0 if known else inflation.at(tilt, pixel)) * patch for tilt, pixel, patch in bands),
        patch_px=_reach_px(sums),
        elevation=elevation,
        ball_gains=tuple(tuple(more * gain for gain in ball) for ball in gains),
        ball_places=places,
    )


class ReadsSlopes(Protocol):
    """A map from intensities to slopes; an inverse map, or several together."""

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Return slopes p and q, float64 array of shape (N, 2)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class OverCells:
    """A map from means of intensity over cells to slopes.

    reads : fitted to all balls, by ball in the order of the presses
    without : the same, fitted without that ball
    size_px : of a cell
    """

    reads: Sequence[ReadsSlopes]
    without: Sequence[ReadsSlopes]
    size_px: int

    def means_of(self, presses: Pressed) -> Pressed:
        """Return the presses with the mean of a cell around each pixel in its place."""
        size = (self.size_px, self.size_px)
        return [
            (replace(image, values=np.asarray(cv2.blur(image.values, size), np.float32)), balls)
            for image, balls in presses
        ]


class ErrorByTilt(NamedTuple):
    """Tilt of the surface (degrees), and the error from pixel to pixel and over a patch there (degrees)."""

    tilt_deg: tuple[float, ...]
    pixel_deg: tuple[float, ...]
    patch_deg: tuple[float, ...]


def error_by_tilt(presses: Pressed, reads: ReadsSlopes) -> ErrorByTilt:
    """Return what is read wrong of the balls that were pressed."""
    tilt, pixel, patch = zip(*_by_band(list(_ball_errors(presses, lambda _, __: reads))), strict=True)
    return ErrorByTilt(tilt, pixel, patch)


def _with_patches_of(
    pixels: Sequence[tuple[float, float, float]], patches: Sequence[tuple[float, float, float]]
) -> list[tuple[float, float, float]]:
    """Return bands with the pixel part of the ones and the patch part of the others."""
    tilts_deg, _, patch_deg = zip(*patches, strict=True)
    return [(tilt, pixel, float(np.interp(tilt, tilts_deg, patch_deg))) for tilt, pixel, _ in pixels]


def _by_band(errors: Sequence[_BallError]) -> list[tuple[float, float, float]]:
    """Return the middle tilt of each band that balls show, and its pixel and patch part, degrees."""
    tilts, pixels, patches = [np.zeros(0)], [np.zeros((2, 0))], [np.zeros((2, 0))]
    for error in errors:
        sigma_px = max(SPLIT_FRACTION * error.ball.contact_radius_px, 1.0)
        square = (error.truth**2).sum(axis=0)
        angle = error.slope / (1.0 + square)
        smooth = np.stack([_masked_blur(part, error.inside, sigma_px) for part in angle])
        tilts.append(np.degrees(np.arctan(np.sqrt(square[error.inside]))))
        pixels.append((angle - smooth)[:, error.inside])
        patches.append(smooth[:, error.inside])
    tilt, pixel, patch = (np.concatenate(parts, axis=-1) for parts in (tilts, pixels, patches))
    bands = []
    for low, high in pairwise(TILT_EDGES_DEG):
        rows = (tilt >= low) & (tilt < high)
        if rows.sum() >= MIN_PIXELS:
            bands.append((float(tilt[rows].mean()), _spread_deg(pixel[:, rows]), _spread_deg(patch[:, rows])))
    return bands or [(0.0, 0.0, 0.0)]


def _gains(
    errors: Sequence[_BallError], tilts_deg: Sequence[float]
) -> tuple[tuple[tuple[float, ...], ...], tuple[tuple[float, float], ...]]:
    """Return gains at the bands' tilts of every ball that determines them, and the places of these balls."""
    bands = [next(pair for pair in pairwise(TILT_EDGES_DEG) if pair[0] <= tilt < pair[1]) for tilt in tilts_deg]
    found = [gains_of_ball(error.slope, error.truth, error.inside, bands) for error in errors]
    return believed_gains(found), tuple(errors[number].place for number in with_gains(found))


def _spread_deg(angle: Float64Array) -> float:
    return float(np.degrees(np.percentile(np.abs(angle), ONE_SIGMA_PERCENT)))


@dataclass(frozen=True, slots=True)
class _HeightErrors:
    """Slope errors of one ball added up from apex to rim, along rays.

    variance_px2 : mean square of what rays do not share
    slope_variance : mean square of the radial slope error of a patch
    length_px : of a ray
    """

    variance_px2: float
    slope_variance: float
    length_px: float


def _height_errors(error: _BallError) -> _HeightErrors:
    rows, columns = error.inside.shape
    length = INNER_FRACTION * error.ball.contact_radius_px
    radius = (np.arange(STEPS) + 0.5) * length / STEPS
    angle = np.arange(RAYS)[:, None] * (2.0 * np.pi / RAYS)
    column = np.rint(error.ball.column + radius * np.cos(angle)).astype(np.intp)
    row = np.rint(error.ball.row + radius * np.sin(angle)).astype(np.intp)
    seen = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    row, column = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)
    seen &= error.inside[row, column]
    sigma_px = max(SPLIT_FRACTION * error.ball.contact_radius_px, 1.0)
    smooth = [_masked_blur(part, error.inside, sigma_px)[row, column] for part in error.slope]
    radial = np.where(seen, smooth[0] * np.cos(angle) + smooth[1] * np.sin(angle), 0.0)
    heights = radial.sum(axis=1) * length / STEPS
    return _HeightErrors(
        variance_px2=float(heights.var()),
        slope_variance=float((radial**2).sum() / max(seen.sum(), 1)),
        length_px=length,
    )


def _reach_px(sums: Sequence[_HeightErrors]) -> float:
    """Return the standard deviation of the Gaussian patches that add up to the same error of height along a ray.

    Noise blurred by a Gaussian σ is alike over 2 sqrt(π) σ: a sum over a length l has so many times l its variance.
    """
    if not sums:
        return SHORTEST_REACH_PX
    variance = sum(part.variance_px2 for part in sums)
    per_reach = sum(part.slope_variance * part.length_px for part in sums) * 2.0 * np.sqrt(np.pi)
    longest = max(part.length_px for part in sums)
    return float(np.clip(variance / max(per_reach, 1e-12), SHORTEST_REACH_PX, longest))


def _ball_errors(
    presses: Pressed, reader: Callable[[NormalizedImage, int], ReadsSlopes], rim_px: float = 0.0
) -> Iterator[_BallError]:
    """Yield the slope error of each ball that shows enough faithful pixels.

    reader : of an image and the number of a ball among all
    rim_px : width of the rim whose means reach beyond the contact
    """
    number = count()
    for image, balls in presses:
        for ball in balls:
            reads = reader(image, next(number))
            window = _window(ball, image.shape)
            row, column = np.mgrid[window].astype(np.float32)
            reach_px = max(ball.contact_radius_px - rim_px, 0.0)
            inside = (column - ball.column) ** 2 + (row - ball.row) ** 2 < reach_px**2
            inside &= image.faithful_at(window)
            if inside.sum() < MIN_PIXELS:
                continue
            read = reads.predict(image.values[window][inside], column[inside], row[inside])
            ball = _centred(ball, read, column[inside], row[inside])
            truth = np.stack(sphere_slopes(ball, column, row)).astype(np.float64)
            slope = np.zeros((2, *inside.shape))
            slope[:, inside] = read.T - truth[:, inside]
            here = Ball(
                ball.column - window[1].start, ball.row - window[0].start, ball.contact_radius_px, ball.radius_px
            )
            place = float(ball.column / image.shape[1]), float(ball.row / image.shape[1])
            yield _BallError(slope, inside, truth, here, place)


def _centred(ball: Ball, read: Float64Array, column: Float32Array, row: Float32Array) -> Ball:
    """Return the ball where its own gentle slopes, float64 array of shape (N, 2), put its centre.

    An error of the centre is an error of the truth: it would be taken for one of the map, all over the ball.
    """
    truth = np.stack(sphere_slopes(ball, column, row), axis=-1)
    gentle = (truth**2).sum(axis=1) < GENTLE**2
    if gentle.sum() < MIN_PIXELS:
        return ball
    off = np.median(read[gentle] - truth[gentle], axis=0)
    return replace(ball, column=ball.column + ball.radius_px * off[0], row=ball.row + ball.radius_px * off[1])


def _window(ball: Ball, shape: tuple[int, int]) -> tuple[slice, slice]:
    reach = int(np.ceil(ball.contact_radius_px)) + 1
    row, column = round(ball.row), round(ball.column)
    rows = slice(max(row - reach, 0), max(min(row + reach + 1, shape[0]), 0))
    return rows, slice(max(column - reach, 0), max(min(column + reach + 1, shape[1]), 0))


def _masked_blur(values: Float64Array, inside: MaskArray, sigma_px: float) -> Float64Array:
    """Return gaussian mean over the pixels inside only."""
    weight = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), sigma_px)
    blurred = cv2.GaussianBlur(values.astype(np.float32), (0, 0), sigma_px)
    return np.asarray(blurred / np.maximum(weight, 1e-6), np.float64)


# By how much a map errs more on a ball that it did not see than on its training balls.

LONE_BALL_INFLATION: Final = 2.0
"""For a map trained on one ball alone, so that none is left to hold out."""

MAX_SAMPLES: Final = 20_000

MEAN_OF_TWO: Final = float(np.sqrt(np.pi / 2.0))
"""Mean angle of the normal when each of its two components errs by a standard deviation of 1 (Rayleigh)."""

MIN_FRACTION: Final = 0.1
"""Whatever its noise, this share of the fitted error's square counts as the map's."""


@dataclass(frozen=True, slots=True)
class BandErrors:
    """Mean angular errors of the normal between two tilts, all in degrees."""

    from_deg: float
    to_deg: float
    held_out_deg: float
    fitted_deg: float

    def inflation(self, pixel_deg: float) -> float:
        """Return held-out over fitted error, 1 at least, without the noise that both hold.

        pixel_deg : standard deviation of a component from pixel to pixel
        """
        noise = (MEAN_OF_TWO * pixel_deg) ** 2
        fitted = max(self.fitted_deg**2 - noise, MIN_FRACTION * self.fitted_deg**2)
        return float(np.sqrt(max((self.held_out_deg**2 - self.fitted_deg**2) / fitted, 0.0) + 1.0))


@dataclass(frozen=True, slots=True)
class Inflation:
    """The errors over all pixels and band by band; no errors where no ball was held out."""

    overall: BandErrors | None
    bands: tuple[BandErrors, ...] = ()

    def at(self, tilt_deg: float, pixel_deg: float) -> float:
        """Return the factor at a tilt, that of all pixels where no band holds it."""
        band = next((band for band in self.bands if band.from_deg <= tilt_deg < band.to_deg), self.overall)
        return LONE_BALL_INFLATION if band is None else band.inflation(pixel_deg)

    def throughout(self, pixel_deg: float) -> float:
        """Return the factor over all tilts."""
        return LONE_BALL_INFLATION if self.overall is None else self.overall.inflation(pixel_deg)


def held_out_inflation(samples: BallSamples, fit: InverseFit) -> Inflation:
    """Return the inflation of a fit, by its training samples."""
    if fit.held_out_deg is None:
        return Inflation(None)
    step = max(1, len(samples.p) // MAX_SAMPLES)
    read = fit.map.predict(samples.intensity[::step], samples.column[::step], samples.row[::step])
    truth = np.stack([samples.p[::step], samples.q[::step]], axis=-1).astype(np.float64)
    error = angle_between_deg(read, truth)
    tilt = np.degrees(np.arctan(np.linalg.norm(truth, axis=1)))

    def errors(band: SlopeBand) -> BandErrors | None:
        rows = (tilt >= band.from_deg) & (tilt < band.to_deg)
        if min(int(rows.sum()), band.pixels) < MIN_BAND_PIXELS:
            return None
        return BandErrors(band.from_deg, band.to_deg, band.error_deg, float(error[rows].mean()))

    overall = BandErrors(0.0, 90.0, fit.held_out_deg, float(error.mean()))
    return Inflation(overall, tuple(found for band in fit.bands if (found := errors(band))))
