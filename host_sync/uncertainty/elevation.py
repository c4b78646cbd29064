"""Elevation at which balls showed each slope, change of slopes at another one, and height of lights.

Lights that stand near look steeper to skin that is raised towards them: over a plane the direction of a light at the
height h is proportional to 1 / (h - z). A ball shows its gentle slopes high up and its steep ones lower; an object that
shows them z - z_ball higher is read too steep by the share (z - z_ball) / h.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

from device.balls.sphere import Ball, BallSamples
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.inverse_map.near_light import GENTLE, direction_features, lit_by
from device.inverse_map.regressor import field_position, monomials, position_exponents
from device.surface import Float32Array, Float64Array, HeightMap, integrate_dct
from host_sync.gradients.inverse_map_kernel import cell_slopes
from host_sync.integration.datum import untouched_mask, zero_to_datum

MAX_PRESSES: Final = 3
"""Presses whose apexes are measured."""

CELL_PX: Final = 4
"""Width of a cell, pixels; an apex spans several."""

NEAREST_FRACTION: Final = 0.2
"""No light is taken to stand lower than five times the balls' apexes."""


class ElevationCorrection(msgspec.Struct, frozen=True):
    """Elevation of the balls of a calibration, by which slopes are corrected.

    apex_px : elevation of their apexes over untouched skin, pixels
    radius_px : their radius, pixels
    nearness_per_px : one over the lights' height over the skin; 0 for lights far away. Where slopes are corrected for
        elevation, the standard uncertainty of what they are corrected for
    """

    apex_px: float
    radius_px: float
    nearness_per_px: float

    def steeper(self, z_px: Float32Array, square: Float32Array) -> Float32Array:
        """Return the fraction by which slopes are read too steep; arrays of one shape.

        z_px : elevation, pixels
        square : p² + q²
        """
        return np.asarray((z_px - self.trained_px(square)) * np.float32(self.nearness_per_px), np.float32)

    def trained_px(self, square: Float32Array) -> Float32Array:
        """Return the elevation at which balls showed slopes of which p² + q² is `square`, pixels."""
        drop = np.float32(self.radius_px) * (np.float32(1.0) - np.float32(1.0) / np.sqrt(np.float32(1.0) + square))
        return np.asarray(np.maximum(np.float32(self.apex_px) - drop, np.float32(0.0)))

    def shared(self, share: float) -> ElevationCorrection:
        """Return the correction for lights of which only a share of their nearness is there."""
        return ElevationCorrection(self.apex_px, self.radius_px, share * self.nearness_per_px)

    def enlarged(self, factor: float) -> ElevationCorrection:
        """Return the correction in frames with `factor` times as many pixels in each direction."""
        return ElevationCorrection(factor * self.apex_px, factor * self.radius_px, self.nearness_per_px / factor)


def elevation_correction(
    presses: Sequence[tuple[NormalizedImage, Sequence[Ball]]], training: BallSamples, inverse: InverseMap
) -> ElevationCorrection:
    """Return the elevation of the balls of a calibration's presses, from their map and its training samples."""
    radius_px = float(np.median([ball.radius_px for _, balls in presses for ball in balls]))
    shown = [(image, balls) for image, balls in presses if balls][:MAX_PRESSES]
    apex_px = float(np.median([apex for image, balls in shown for apex in apexes_px(image, balls, inverse)]))
    most = NEAREST_FRACTION / max(apex_px, 1.0)
    return ElevationCorrection(apex_px, radius_px, min(nearness_per_px(training, inverse.shape), most))


def apexes_px(image: NormalizedImage, balls: Sequence[Ball], inverse: InverseMap) -> list[float]:
    """Return the elevation of each ball's apex as the map reads its press.

    It is at least the elevation over the rim of the ball's own contact.
    """
    gradients = cell_slopes(image, inverse, CELL_PX)
    # In pixels instead of µm: zero as a scan's height map has it.
    height = HeightMap(integrate_dct(gradients.p, gradients.q, float(CELL_PX)), float(CELL_PX))
    z_px = zero_to_datum(height, untouched_mask(gradients)).z_um
    return [apex_in_cells_px(z_px, ball, CELL_PX) for ball in balls]


def apex_in_cells_px(z_px: Float32Array, ball: Ball, cell: int) -> float:
    """Return the elevation of a ball's apex, pixels: that over its own contact's rim at least.

    z_px : elevation of cells of `cell` x `cell` pixels, shape (h, w); beyond the border that of the nearest one counts
    """
    last_row, last_column = (size - 1 for size in z_px.shape)
    row, column = (int(np.rint(at)) // cell for at in (ball.row, ball.column))
    here = float(z_px[min(max(row, 0), last_row), min(max(column, 0), last_column)])
    return max(here, ball.radius_px - float(np.sqrt(ball.radius_px**2 - ball.contact_radius_px**2)))


# Height of the lights over the skin, estimated from balls in different places.
#
# Under a point at the height h over the place (X, Y) a matt skin of slope g shows, divided by its reference, I √(1 +
# |g|²) = 1 + a·g with a = (x - X, y - Y) / h: from pixel to pixel a changes by 1 / h, the same in every channel and in
# mixtures of lights. Lights shine more to one side than to the other, so that directions bend over the field (see
# `device.inverse_map.near_light`), but a few balls leave such bends to chance: the one number is fitted first, then as
# much of the bends as the balls determine well.

PLACE_DEGREE: Final = 2
"""Degree in position of the directions."""

MAX_SAMPLES: Final = 20_000
MIN_SAMPLES: Final = 100
MIN_SINGULAR_VALUE: Final = 0.1
"""Singular value, as a share of the largest, from which a combination of bends is taken; a dozen balls reach 0.19."""


def nearness_per_px(training: BallSamples, shape: tuple[int, int]) -> float:
    """Return one over the height of the lights, per pixel of a full-size field (H, W); 0 for lights that are far away.

    0 too where no slope is gentle: then nothing determines it.
    """
    gentle = np.flatnonzero(np.hypot(training.p, training.q) < GENTLE)
    if gentle.size < MIN_SAMPLES:
        return 0.0
    rows = gentle[:: max(1, gentle.size // MAX_SAMPLES)]
    slope = np.stack([training.p[rows], training.q[rows]], axis=-1).astype(np.float64)
    place = field_position(training.column[rows].astype(np.float64), training.row[rows].astype(np.float64), shape)
    brightness = lit_by(training.intensity[rows], slope)
    features = direction_features(slope, monomials(place, PLACE_DEGREE))
    directions = _of_points(slope, place, brightness, shape)
    directions += np.linalg.lstsq(features, brightness - features @ directions, rcond=MIN_SINGULAR_VALUE)[0]
    return max(0.5 * sum(float(directions[term].mean()) / pixels for term, pixels in _changes(shape)), 0.0)


def _of_points(
    slope: Float64Array, place: Float64Array, brightness: Float64Array, shape: tuple[int, int]
) -> Float64Array:
    """Return how directions change over the field under points of one height: float64 array (features, channels).

    A ball's apex is nearer to the lights than its rim and brighter: a constant and |g|² take that up.
    """
    reach = (0.5 * np.array(shape[::-1]) * place * slope).sum(axis=1)
    far = np.stack([np.ones_like(reach), *slope.T, (slope**2).sum(axis=1)], axis=-1)
    alike, _ = np.linalg.qr(far)
    reach -= alike @ (alike.T @ reach)
    nearness = float((reach @ brightness).mean() / max(reach @ reach, 1e-12))
    directions = np.zeros((2 * len(position_exponents(PLACE_DEGREE)), brightness.shape[1]))
    for term, pixels in _changes(shape):
        directions[term] = nearness * pixels
    return directions


def _changes(shape: tuple[int, int]) -> list[tuple[int, float]]:
    """Return the features by which a changes along the axis of its component, and pixels in a unit of position."""
    exponents = position_exponents(PLACE_DEGREE)
    return [(2 * exponents.index((1, 0)), 0.5 * shape[1]), (2 * exponents.index((0, 1)) + 1, 0.5 * shape[0])]
