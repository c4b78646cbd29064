"""What skin beside a place shows: its light falls on skin that slants.

A slope of tilt t sees level skin around it over (1 - cos t) / 2 of what is above it (view factor of a tilted plane; Liu
and Jordan, "The long-term average performance of flat-plate solar-energy collectors", Solar Energy 7, 1963). How bright
skin close by is, under all lamps at once, the frame itself tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array, Float64Array, MaskArray
from host_sync.kernels.cell_rows import cell_px, means_of_cells

CLOSE_WIDTHS: Final = 0.02
"""Standard deviation of the Gaussian over skin close by, in widths of the field.

On a bench without noise 0.015 and 0.02 leave the least of the balls (0.0020 against 0.0022 at 0.01, 0.0023 at 0.03); of
other objects 0.02 leaves less (decision 0034).
"""

ALL: Final = 0.999
"""Share of a cell's pixels that are faithful in a cell whose intensity counts."""


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What a frame's skin shows on the mean close to the middles of cells.

    intensity : divided by that of untouched skin, float32 array of shape (h, w, 3)
    cell : pixels along a cell
    """

    intensity: Float32Array
    cell: int

    @classmethod
    def of(cls, image: NormalizedImage) -> Surroundings:
        """The surroundings in an image; cells with a saturated pixel, or a dark reference, count as untouched skin."""
        cell = cell_px(image.shape)
        return cls.of_cells(*faithful_cells(image, cell), cell)

    @classmethod
    def of_cells(cls, intensity: Float64Array, faithful: MaskArray, cell: int) -> Surroundings:
        """The same of an image's cells, as of `faithful_cells`."""
        shown = np.nan_to_num(intensity, nan=1.0)
        known = np.where(faithful[..., None], shown, 1.0).astype(np.float32)
        return cls(np.asarray(cv2.GaussianBlur(known, (0, 0), CLOSE_WIDTHS * known.shape[1]), np.float32), cell)

    def at(self, column: Float64Array, row: Float64Array) -> Float64Array:
        """What skin close to pixels of these places (N,) shows, by the cell they lie in: shape (N, 3)."""
        down, across = (np.rint(place).astype(np.intp) // self.cell for place in (row, column))
        return self.intensity[down, across].astype(np.float64)


def faithful_cells(image: NormalizedImage, cell: int) -> tuple[Float64Array, MaskArray]:
    """Mean intensity of an image's cells of `cell` x `cell` pixels, shape (h, w, 3), and where no pixel is saturated or
    dark, bool array of shape (h, w).
    """
    size = (-(-image.shape[0] // cell), -(-image.shape[1] // cell))
    share = means_of_cells(image.faithful.astype(np.float32)[..., None], size, cell)[..., 0]
    return means_of_cells(image.values, size, cell), share > ALL
