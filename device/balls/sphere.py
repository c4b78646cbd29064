"""A ball pressed into the skin, its image in a camera nearby, and its training pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.errors import CalibrationError
from device.imaging.flat_field import NormalizedImage
from device.surface import Float32Array, Float64Array

MIN_HEIGHTS: Final = 5.0
"""Times a ball's elevation that a camera's height must be."""

INVERSE_ROUNDS: Final = 8
"""Each makes the error of an offset smaller by slope times the tangent of the viewing angle: 0.01 to 0.2."""


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """Position of a camera that looks straight down, pixels of untouched skin.

    A camera nearby sees raised skin larger, and farther from the middle: a pixel's ray meets skin at the elevation z
    where it leans by z / height towards the middle of the field.

    column, row : the place below it
    height_px : its height over untouched skin, as rays inside the gel see it
    """

    column: float
    row: float
    height_px: float

    @classmethod
    def over_middle(cls, height_mm: float, pitch_um: float, shape: tuple[int, int]) -> Viewpoint:
        """Over the middle of a field of `shape` (H, W) whose pixels are `pitch_um` apart."""
        rows, columns = shape
        return cls(0.5 * (columns - 1), 0.5 * (rows - 1), height_mm * 1e3 / pitch_um)

    def enlarged(self, factor: float) -> Viewpoint:
        """Return the same over a frame with `factor` times as many pixels in each direction."""
        column, row = (factor * (place + 0.5) - 0.5 for place in (self.column, self.row))
        return Viewpoint(column, row, factor * self.height_px)

    def offsets_from_axis(
        self,
        pixel: Float64Array,
        centre: Float64Array,
        radius_px: Float64Array | float,
        apex_px: Float64Array | float,
    ) -> Float64Array:
        """Return where pixels (2, ...) inside spheres see them: right and down of each one's axis, shape (2, ...).

        pixel : column and row
        centre : column and row at which the sphere's apex is seen; it broadcasts with `pixel`
        radius_px : of the sphere
        apex_px : elevation of its apex over untouched skin
        """
        middle = np.array([self.column, self.row]).reshape(2, *(1,) * (np.ndim(pixel) - 1))
        at_apex = (pixel - centre) * (1.0 - apex_px / self.height_px)
        leaning = (pixel - middle) / self.height_px
        offset = at_apex
        for _ in range(INVERSE_ROUNDS):
            below = radius_px - np.sqrt(np.maximum(radius_px**2 - (offset**2).sum(axis=0), 1.0))
            offset = at_apex + below * leaning
        return np.asarray(offset)


@dataclass(frozen=True, slots=True)
class Ball:
    """One ball in one frame, in pixels.

    column, row : centre
    contact_radius_px : the skin is trusted to follow the sphere inside this radius
    radius_px : radius of the sphere itself
    viewpoint : where the camera looks from; None where nobody knows: it is taken to see all skin from straight above
    apex_px : elevation of its apex over untouched skin, which counts with a viewpoint
    """

    column: float
    row: float
    contact_radius_px: float
    radius_px: float
    viewpoint: Viewpoint | None = None
    apex_px: float = 0.0

    @property
    def steepest(self) -> float:
        """Slope of the sphere at the border of the contact."""
        return float(self.contact_radius_px / np.sqrt(self.radius_px**2 - self.contact_radius_px**2))

    @property
    def seen_larger(self) -> float:
        """Magnification of the skin at its apex in the camera's image, relative to untouched skin."""
        return 1.0 if self.viewpoint is None else 1.0 / (1.0 - self.apex_px / self.viewpoint.height_px)

    def enlarged(self, factor: float) -> Ball:
        """Return the same ball in a frame with `factor` times as many pixels in each direction."""
        column, row = (factor * (place + 0.5) - 0.5 for place in (self.column, self.row))
        viewpoint = self.viewpoint and self.viewpoint.enlarged(factor)
        contact_px, radius_px, apex_px = (
            factor * size for size in (self.contact_radius_px, self.radius_px, self.apex_px)
        )
        return Ball(column, row, contact_px, radius_px, viewpoint, apex_px)


@dataclass(frozen=True, slots=True, eq=False)
class BallSamples:
    """Pixels inside the contacts of balls; all arrays share their first axis (N).

    intensity : float32 array of shape (N, 3)
    p, q : float32 arrays of shape (N,), slope of the sphere
    column, row : float32 arrays of shape (N,), pixel position
    ball : int array of shape (N,), index of the ball that a pixel belongs to
    quiet : intensity with its noise averaged (`quiet_intensity`), of its shape; None where that was not done
    """

    intensity: Float32Array
    p: Float32Array
    q: Float32Array
    column: Float32Array
    row: Float32Array
    ball: NDArray[np.intp]
    quiet: Float32Array | None = None

    @property
    def training_intensity(self) -> Float32Array:
        """Intensity that maps are fitted to, with its noise averaged where that was done."""
        return self.intensity if self.quiet is None else self.quiet

    def select(self, rows: NDArray[np.intp]) -> BallSamples:
        """Some of the samples; balls keep their numbers."""
        return BallSamples(
            self.intensity[rows],
            self.p[rows],
            self.q[rows],
            self.column[rows],
            self.row[rows],
            self.ball[rows],
            None if self.quiet is None else self.quiet[rows],
        )

    def enlarged(self, factor: float) -> BallSamples:
        """Return the same samples at their places in a frame with `factor` times as many pixels in each direction."""
        column, row = (np.asarray(factor * (place + 0.5) - 0.5, np.float32) for place in (self.column, self.row))
        return replace(self, column=column, row=row)


def sphere_slopes(ball: Ball, column: Float32Array, row: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return slopes (p, q) of the sphere that pixels inside it see, arrays of the shape of `column`."""
    across, down = column - np.float32(ball.column), row - np.float32(ball.row)
    if ball.viewpoint is not None:
        pixel = np.stack([column, row]).astype(np.float64)
        centre = np.array([ball.column, ball.row]).reshape(2, *(1,) * column.ndim)
        across, down = ball.viewpoint.offsets_from_axis(pixel, centre, ball.radius_px, ball.apex_px)
    height = np.sqrt(np.maximum(ball.radius_px**2 - across**2 - down**2, 1e-6))
    return (-across / height).astype(np.float32), (-down / height).astype(np.float32)


def gather_samples(presses: Iterable[tuple[NormalizedImage, Sequence[Ball]]], *, for_fit: bool = False) -> BallSamples:
    """Return samples of every faithful pixel inside the contact of every ball of every press, in order.

    for_fit : average their noise too, for a map that is fitted to them

    Raises
    ------
    CalibrationError
        No press shows a ball.
    """
    parts: list[tuple[NDArray[np.float32], ...]] = []
    owners: list[NDArray[np.intp]] = []
    number = 0
    for image, balls in presses:
        for ball in balls:
            row, column = pixels_inside(ball, image.shape)
            faithful = image.faithful_at((row, column))
            row, column = row[faithful], column[faithful]
            slopes = sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32))
            seen = image.values[row, column]
            quiet = quiet_intensity(seen, row, column, ball.contact_radius_px) if for_fit else seen
            parts.append((seen, *slopes, column.astype(np.float32), row.astype(np.float32), quiet))
            owners.append(np.full(column.size, number))
            number += 1
    if not parts:
        raise CalibrationError("no ball was found in any calibration press: press a ball of known radius and try again")
    intensity, p, q, columns, rows, quiet = (np.concatenate(part) for part in zip(*parts, strict=True))
    return BallSamples(intensity, p, q, columns, rows, np.concatenate(owners), quiet if for_fit else None)


def pixels_inside(ball: Ball, shape: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the pixels inside a ball's contact that a frame of `shape` (H, W) holds."""
    rows, columns = shape
    reach = int(np.ceil(ball.contact_radius_px)) + 1
    top, left = max(int(ball.row) - reach, 0), max(int(ball.column) - reach, 0)
    row, column = np.mgrid[
        top : min(int(ball.row) + reach + 1, rows), left : min(int(ball.column) + reach + 1, columns)
    ]
    inside = (column - ball.column) ** 2 + (row - ball.row) ** 2 <= ball.contact_radius_px**2
    return row[inside], column[inside]


# Intensity of a ball's pixels without most of their noise, to which an inverse map is fitted.
#
# A map that is fitted from noisy colours to true slopes reads flatter than the truth: least squares finds the mean
# slope of all pixels that look so, and noise mixes gentler ones among them (regression dilution; Fuller, "Measurement
# Error Models", 1987). It flattens all of an object by one share, which integration keeps, while noise itself averages
# out. On a ball intensity is smooth, so that its noise can be averaged beforehand: a polynomial over the contact
# follows the ball, and a Gaussian over neighbours inside the contact what the polynomial leaves.

DEGREE: Final = 5
SIGMA_PX: Final = 2.0
"""Standard deviation of the Gaussian."""

SIGMA_FRACTION: Final = 0.03
"""Largest standard deviation as a share of the contact's radius: a small ball bends within few pixels."""

OUTLYING: Final = 4.0
"""Times the median of what the polynomial leaves from which a pixel counts less: dust, a hair, skin that has lifted."""

ROUNDS: Final = 3
"""Fits of the polynomial, each with the weights that the last one gives."""

MIN_PIXELS_PER_TERM: Final = 10
"""Contacts with fewer pixels keep their noise."""


def quiet_intensity(
    intensity: Float32Array, row: NDArray[np.intp], column: NDArray[np.intp], contact_radius_px: float
) -> Float32Array:
    """Return intensities of a ball's pixels with their noise averaged, float32 array of shape (N, 3).

    intensity : float32 array of shape (N, 3), as seen
    row, column : int arrays of shape (N,), each pixel once
    """
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    if len(row) < MIN_PIXELS_PER_TERM * len(powers):
        return intensity
    across, down = ((place - place.mean()) / contact_radius_px for place in (column, row))
    rising = [np.vander(place, DEGREE + 1, increasing=True).T for place in (across, down)]
    terms = np.stack([rising[0][i] * rising[1][j] for i, j in powers], axis=-1)
    seen, weight = intensity.astype(np.float64), np.ones(len(row))
    for _ in range(ROUNDS):
        weighed = terms * weight[:, None]
        gram = weighed.T @ terms + 1e-9 * len(terms) * np.eye(len(powers))
        left = seen - terms @ np.linalg.solve(gram, weighed.T @ seen)
        length = np.linalg.norm(left, axis=1)
        outlying = OUTLYING * max(float(np.median(length)), 1e-6)
        weight = np.where(length > outlying, (outlying / np.maximum(length, outlying)) ** 2, 1.0)
    sigma_px = min(SIGMA_PX, SIGMA_FRACTION * contact_radius_px)
    return np.asarray(seen - left + _averaged(left, weight, row, column, sigma_px), np.float32)


def _averaged(
    left: Float64Array, weight: Float64Array, row: NDArray[np.intp], column: NDArray[np.intp], sigma_px: float
) -> Float64Array:
    """Return the weighted means of values (N, 3) over neighbours that are there."""
    here = row - row.min(), column - column.min()
    size = int(here[0].max()) + 1, int(here[1].max()) + 1
    values, known = np.zeros((*size, left.shape[1]), np.float32), np.zeros(size, np.float32)
    values[here], known[here] = weight[:, None] * left, weight
    total, whole = (cv2.GaussianBlur(part, (0, 0), sigma_px)[here] for part in (values, known))
    return np.asarray(total / np.maximum(whole, 1e-6)[:, None], np.float64)
