"""Bias of a ball's radius in the quick look, from the calibration's own balls and from its height.

A light of a few millimetres' height comes nearer to skin that is pressed towards it, and shades its slopes more. An
inverse map knows the height of the balls that it was trained on only: balls that stand lower read too flat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

PositionMm = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class BallReading:
    """A ball in a quick look: radius, and height of its top above the untouched skin, µm."""

    radius_um: float
    top_um: float


@dataclass(frozen=True, slots=True)
class BallBias:
    """Bias that the calibration's own balls have.

    fraction : their radius as read over the stated one, median
    top_um : height of their tops above the untouched skin, median, µm
    lights_mm : position of each light
    """

    fraction: float
    top_um: float
    lights_mm: tuple[PositionMm, ...]

    @classmethod
    def of(
        cls, readings: Sequence[BallReading], stated_um: Sequence[float], lights_mm: Sequence[PositionMm]
    ) -> BallBias:
        """The bias of at least one reading, beside the radii that the calibration states."""
        fractions = [reading.radius_um / radius for reading, radius in zip(readings, stated_um, strict=True)]
        tops = [reading.top_um for reading in readings]
        return cls(float(np.median(fractions)), float(np.median(tops)), tuple(lights_mm))

    def corrected_um(self, reading: BallReading) -> float:
        """The radius without the bias, µm."""
        lower = shading(self.lights_mm, self.top_um) / shading(self.lights_mm, reading.top_um)
        return reading.radius_um / (self.fraction * lower)


def shading(lights_mm: Sequence[PositionMm], height_um: float) -> float:
    """Return how much more skin at a height shows of its slopes than untouched skin, in the middle of the field, mean
    of the lights: the inverse cube of their distance. At most half a light's height counts.
    """
    found = []
    for x, y, z in lights_mm:
        aside, above = float(np.hypot(x, y)), z - min(max(height_um * 1e-3, 0.0), 0.5 * z)
        found.append((np.hypot(aside, z) / np.hypot(aside, above)) ** 3)
    return float(np.mean(found))
