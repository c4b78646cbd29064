"""A quadratic function of the normal, fitted to the balls of a calibration, corrects slopes.

The inverse map, which a dozen balls teach, reads skin between them some per mille too flat or too steep. The quadric
reads the mean intensities of cells of pixels, too; by how much it reads them otherwise than the map is added to the
slopes of every pixel. Cells that it does not explain are left as the map reads them.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from host_sync.kernels.cell_rows import cell_px, middles_of_cells
from host_sync.lights.normal_quadric import FittedQuadric
from host_sync.lights.surroundings import faithful_cells
from host_sync.reconstruction.cell_correction import CellCorrection, SlopePair, steepness, unsure_cells

EXPLAINED: Final = (0.08, 0.16)
"""Root mean square of what a quadric leaves of a cell's three channels, as a share of its contrast: up to the first it
explains the cell, from the second on it does not: a light is hidden, or something lies on the skin."""


def read_by_quadric(image: NormalizedImage, inverse_map: InverseMap, quadric: FittedQuadric) -> CellCorrection:
    """What the slopes of an image (H, W) gain that an inverse map read."""
    cell = cell_px(image.shape)
    means, faithful = faithful_cells(image, cell)
    means, size = np.nan_to_num(means, nan=1.0), (faithful.shape[0], faithful.shape[1])
    row, column = middles_of_cells(size, cell)
    read = inverse_map.on_grid(means.astype(np.float32), column, row).astype(np.float64)
    steep = steepness(read)
    here = np.flatnonzero((steep > 0.0) & faithful)
    places = column[here % size[1]], row[here // size[1]]
    skin, seen, before = quadric.model.at(*places), means.reshape(-1, 3)[here], read.reshape(-1, 2)[here]
    found = skin.slopes(seen, before)
    shown, changes = skin.shown_and_changes(found)
    left = np.sqrt(((seen - shown) ** 2).mean(axis=1)) / quadric.model.contrast()
    counts = faithful.astype(np.float64)
    told = np.count_nonzero(shown > 0.0, axis=1) >= 2
    counts.ravel()[here] = told * np.clip((EXPLAINED[1] - left) / (EXPLAINED[1] - EXPLAINED[0]), 0.0, 1.0)
    change = np.zeros((2, *size), np.float32)
    change.reshape(2, -1)[:, here] = ((steep * counts).ravel()[here, None] * (found - before)).T

    def unsure() -> SlopePair:
        return unsure_cells(here, size, changes, [shown - fold.at(*places).shown(found) for fold in quadric.folds])

    nothing, left_alone = np.zeros(size, np.float32), (1.0 - counts).astype(np.float32)
    return CellCorrection(change[0], change[1], nothing, nothing, nothing, cell, 1.0, unsure, left_alone)
