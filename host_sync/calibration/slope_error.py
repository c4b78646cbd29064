"""How wrong the slopes are, in four parts that bend a height map over ever longer distances.

* from pixel to pixel: noise and pigment, which average out
* over a patch: what the map gets wrong of a ball it did not see
* over the whole press: a ball shows each slope at one elevation only. Raised skin stands closer to the lights and is
  brighter at the same slope; an object that shows that slope at another elevation is read wrong, everywhere alike.
* over the whole press: all slopes read too steep or too flat by one share, so that heights are off by it
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import cv2
import msgspec
import numpy as np

from device.ball import Ball, BallSamples, gather_samples, sphere_slopes
from device.inverse_map import InverseMap
from device.photometry import IntensityImage
from device.surface import Float64Array, MaskArray
from host_sync.calibration.ball_radii import radius_shares

SPLIT_SHARE: Final = 0.1
"""Standard deviation of the Gaussian that parts pixel from patch, as a share of the contact radius."""

APEX_SLOPE: Final = 0.1
INNER_SHARE: Final = 0.9
FEWEST_PIXELS: Final = 50

Pressed = Sequence[tuple[IntensityImage, Sequence[Ball]]]


class SlopeError(msgspec.Struct, frozen=True):
    """Standard deviations of one slope component on a flat, as angles; both grow as 1 + p² + q².

    pixel_deg : the part that is independent from pixel to pixel
    patch_deg : the part that is the same over a patch
    patch_px : size of such a patch, the standard deviation of a Gaussian
    raised_shade : by what share the balls' apexes are brighter than untouched skin, in R, G, B
    scale_share : by what share a ball's slopes are read too steep or too flat, root mean square over balls
    """

    pixel_deg: float
    patch_deg: float
    patch_px: float
    raised_shade: tuple[float, float, float]
    scale_share: float


def measure_slope_error(presses: Pressed, inverse_map: InverseMap, inflation: float) -> SlopeError:
    """The slope error on the balls of a calibration.

    inflation : held-out error over fitted error, by which the patch part is scaled
    """
    pixel: list[Float64Array] = []
    patch: list[Float64Array] = []
    widths: list[float] = []
    for ball, error, inside in _ball_errors(presses, inverse_map):
        sigma_px = max(SPLIT_SHARE * ball.contact_radius_px, 1.0)
        smooth = _masked_blur(error, inside, sigma_px)
        pixel.append((error - smooth)[inside] ** 2)
        patch.append(smooth[inside] ** 2)
        widths.append(3.0 * sigma_px)
    pixel_deg, patch_deg = (float(np.degrees(np.sqrt(np.concatenate(part).mean()))) for part in (pixel, patch))
    samples = gather_samples(presses)
    return SlopeError(
        pixel_deg=pixel_deg,
        patch_deg=patch_deg * inflation,
        patch_px=float(np.median(widths)),
        raised_shade=_raised_shade(samples),
        scale_share=float(np.sqrt(np.nanmean((1.0 / radius_shares(samples, inverse_map) - 1.0) ** 2))),
    )


def _ball_errors(presses: Pressed, inverse_map: InverseMap) -> Iterator[tuple[Ball, Float64Array, MaskArray]]:
    """For each ball and slope component: its error as an angle (radians) in a window, and the pixels that count."""
    for image, balls in presses:
        for ball in balls:
            window = _window(ball, image.shape)
            row, column = np.mgrid[window].astype(np.float32)
            reach = INNER_SHARE * ball.contact_radius_px
            inside = (column - ball.column) ** 2 + (row - ball.row) ** 2 < reach**2
            inside &= image.faithful[window]
            if inside.sum() < FEWEST_PIXELS:
                continue
            column, row = column[inside], row[inside]
            read = inverse_map.predict(image.values[window][inside], column, row)
            truth = np.stack(sphere_slopes(ball, column, row), axis=-1)
            wrong = (read - truth) / (1.0 + (truth**2).sum(axis=-1, keepdims=True))
            for component in wrong.T:
                error = np.zeros(inside.shape)
                error[inside] = component
                yield ball, error, inside


def _raised_shade(samples: BallSamples) -> tuple[float, float, float]:
    apex = samples.p**2 + samples.q**2 < APEX_SLOPE**2
    shade = samples.intensity[apex].mean(axis=0) - 1.0 if apex.any() else np.zeros(3)
    red, green, blue = (float(value) for value in shade)
    return red, green, blue


def _window(ball: Ball, shape: tuple[int, int]) -> tuple[slice, slice]:
    reach = int(np.ceil(ball.contact_radius_px)) + 1
    row, column = round(ball.row), round(ball.column)
    rows = slice(max(row - reach, 0), max(min(row + reach + 1, shape[0]), 0))
    return rows, slice(max(column - reach, 0), max(min(column + reach + 1, shape[1]), 0))


def _masked_blur(values: Float64Array, inside: MaskArray, sigma_px: float) -> Float64Array:
    """Gaussian mean over the pixels inside only."""
    weight = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), sigma_px)
    blurred = cv2.GaussianBlur(values.astype(np.float32), (0, 0), sigma_px)
    return np.asarray(blurred / np.maximum(weight, 1e-6), np.float64)
