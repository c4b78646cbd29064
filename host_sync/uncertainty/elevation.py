"""At which elevation the balls showed each slope, and what it does when an object shows it at another.

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
from device.surface.fields import Float32Array, HeightMap
from device.surface.poisson_dct import integrate_dct
from host_sync.gradients.cell_slopes import cell_slopes
from host_sync.integration.datum import untouched_mask, zero_to_datum
from host_sync.uncertainty.light_height import nearness_per_px

MAX_PRESSES: Final = 3
"""Presses whose apexes are measured."""

CELL_PX: Final = 4
"""Cells of so many pixels tell an apex well enough."""

NEAREST_SHARE: Final = 0.2
"""No light is taken to stand lower than five times the balls' apexes."""


class ElevationCorrection(msgspec.Struct, frozen=True):
    """Of the balls of a calibration.

    apex_px : elevation of their apexes over untouched skin, pixels
    radius_px : their radius, pixels
    nearness_per_px : one over the lights' height over the skin; 0 for lights far away. Where slopes are corrected for
        elevation, the standard uncertainty of what they are corrected for
    """

    apex_px: float
    radius_px: float
    nearness_per_px: float

    def steeper(self, z_px: Float32Array, square: Float32Array) -> Float32Array:
        """By what share slopes are read too steep; arrays of one shape.

        z_px : elevation, pixels
        square : p² + q²
        """
        return np.asarray((z_px - self.trained_px(square)) * np.float32(self.nearness_per_px), np.float32)

    def trained_px(self, square: Float32Array) -> Float32Array:
        """Return the elevation at which balls showed slopes of which p² + q² is `square`, pixels."""
        drop = np.float32(self.radius_px) * (np.float32(1.0) - np.float32(1.0) / np.sqrt(np.float32(1.0) + square))
        return np.asarray(np.maximum(np.float32(self.apex_px) - drop, np.float32(0.0)))

    def shared(self, share: float) -> ElevationCorrection:
        """Return the same for lights of which only a share of their nearness is there."""
        return ElevationCorrection(self.apex_px, self.radius_px, share * self.nearness_per_px)

    def enlarged(self, factor: float) -> ElevationCorrection:
        """Return the same in frames with `factor` times as many pixels in each direction."""
        return ElevationCorrection(factor * self.apex_px, factor * self.radius_px, self.nearness_per_px / factor)


def elevation_correction(
    presses: Sequence[tuple[NormalizedImage, Sequence[Ball]]], training: BallSamples, inverse: InverseMap
) -> ElevationCorrection:
    """Return the elevation of the balls of a calibration's presses, from their map and its training samples."""
    radius_px = float(np.median([ball.radius_px for _, balls in presses for ball in balls]))
    shown = [(image, balls) for image, balls in presses if balls][:MAX_PRESSES]
    apex_px = float(np.median([apex for image, balls in shown for apex in apexes_px(image, balls, inverse)]))
    most = NEAREST_SHARE / max(apex_px, 1.0)
    return ElevationCorrection(apex_px, radius_px, min(nearness_per_px(training, inverse.shape), most))


def apexes_px(image: NormalizedImage, balls: Sequence[Ball], inverse: InverseMap) -> list[float]:
    """Return the elevation of each ball's apex as the map reads its press, pixels: that over its own contact's rim at
    least."""
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
