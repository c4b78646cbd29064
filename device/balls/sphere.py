"""A ball pressed into the skin, and its training pixels.

Inside its contact the skin is the sphere, so that every pixel there has a known slope (paper, section 5.1).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from device.balls.quiet_intensity import quiet_intensity
from device.balls.viewpoint import Viewpoint
from device.errors import CalibrationError
from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array


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
        """How many times as large as untouched skin a camera sees the skin at its apex."""
        return 1.0 if self.viewpoint is None else 1.0 / (1.0 - self.apex_px / self.viewpoint.height_px)

    def enlarged(self, factor: float) -> Ball:
        """The same ball in a frame with `factor` times as many pixels in each direction."""
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
    def taught(self) -> Float32Array:
        """What maps are taught with: intensity with its noise averaged where that was done."""
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
        """The same samples at their places in a frame with `factor` times as many pixels in each direction."""
        column, row = (np.asarray(factor * (place + 0.5) - 0.5, np.float32) for place in (self.column, self.row))
        return replace(self, column=column, row=row)


def sphere_slopes(ball: Ball, column: Float32Array, row: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Slopes (p, q) of the sphere that pixels inside it see, arrays of the shape of `column`."""
    across, down = column - np.float32(ball.column), row - np.float32(ball.row)
    if ball.viewpoint is not None:
        pixel = np.stack([column, row]).astype(np.float64)
        centre = np.array([ball.column, ball.row]).reshape(2, *(1,) * column.ndim)
        across, down = ball.viewpoint.offsets_from_axis(pixel, centre, ball.radius_px, ball.apex_px)
    height = np.sqrt(np.maximum(ball.radius_px**2 - across**2 - down**2, 1e-6))
    return (-across / height).astype(np.float32), (-down / height).astype(np.float32)


def gather_samples(presses: Iterable[tuple[NormalizedImage, Sequence[Ball]]], *, to_teach: bool = False) -> BallSamples:
    """Samples of every faithful pixel inside the contact of every ball of every press, in order.

    to_teach : average their noise too, for a map that they are to teach

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
            quiet = quiet_intensity(seen, row, column, ball.contact_radius_px) if to_teach else seen
            parts.append((seen, *slopes, column.astype(np.float32), row.astype(np.float32), quiet))
            owners.append(np.full(column.size, number))
            number += 1
    if not parts:
        raise CalibrationError("no ball was found in any calibration press: press a ball of known radius and try again")
    intensity, p, q, columns, rows, quiet = (np.concatenate(part) for part in zip(*parts, strict=True))
    return BallSamples(intensity, p, q, columns, rows, np.concatenate(owners), quiet if to_teach else None)


def pixels_inside(ball: Ball, shape: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the pixels inside a ball's contact that a frame of `shape` (H, W) holds."""
    rows, columns = shape
    reach = int(np.ceil(ball.contact_radius_px)) + 1
    top, left = max(int(ball.row) - reach, 0), max(int(ball.column) - reach, 0)
    row, column = np.mgrid[
        top : min(int(ball.row) + reach + 1, rows), left : min(int(ball.column) + reach + 1, columns)
    ]
    inside = (column - ball.column) ** 2 + (row - ball.row) ** 2 <= ball.contact_radius_px**2
    return row[inside], column[inside]
