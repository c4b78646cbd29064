"""Image of a sphere in a camera nearby: raised skin is seen larger, and farther from the middle.

A pixel's ray meets skin at the elevation z where it leans by z / height towards the middle of the field.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float64Array

MIN_HEIGHTS: Final = 5.0
"""Times a ball's elevation that a camera's height must be."""

ROUNDS: Final = 8
"""Each makes the error of an offset smaller by slope times the tangent of the viewing angle: 0.01 to 0.2."""


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """Position of a camera that looks straight down, pixels of untouched skin.

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
        for _ in range(ROUNDS):
            below = radius_px - np.sqrt(np.maximum(radius_px**2 - (offset**2).sum(axis=0), 1.0))
            offset = at_apex + below * leaning
        return np.asarray(offset)
