"""Slopes as a quadratic function of the normal tells them that explains the balls of a calibration.

The inverse map, which is taught by a dozen balls, reads skin between them some per mille too flat or too steep. Over
cells of pixels the quadric reads their mean intensity, too; by how much it reads otherwise than the map is added to the
slopes of every pixel.
"""

from __future__ import annotations

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from host_sync.kernels.cell_rows import cell_px, middles_of_cells
from host_sync.lights.lamp_slopes import INTENSITY_SIGMA, SURFACE_SIGMA, gauss_newton_step
from host_sync.lights.normal_quadric import FittedQuadric
from host_sync.lights.surroundings import faithful_cells
from host_sync.reconstruction.cell_correction import CellCorrection
from host_sync.reconstruction.lamp_reading import LEVEL
from host_sync.uncertainty.calibration_uncertainty import jackknifed


def read_by_quadric(image: NormalizedImage, inverse_map: InverseMap, quadric: FittedQuadric) -> CellCorrection:
    """What the slopes of an image (H, W) gain that an inverse map read."""
    cell = cell_px(image.shape)
    size = (-(-image.shape[0] // cell), -(-image.shape[1] // cell))
    means, faithful = faithful_cells(image, size, cell)
    row, column = middles_of_cells(size, cell)
    read = inverse_map.on_grid(np.nan_to_num(means, nan=1.0).astype(np.float32), column, row).astype(np.float64)
    share = np.clip((np.linalg.norm(read, axis=-1) - LEVEL[0]) / (LEVEL[1] - LEVEL[0]), 0.0, 1.0) * faithful
    here = np.flatnonzero(share > 0.0)
    places = column[here % size[1]], row[here // size[1]]
    skin = quadric.model.at(*places)
    before = read.reshape(-1, 2)[here]
    found = skin.slopes(means.reshape(-1, 3)[here], before)
    change = np.zeros((2, *size), np.float32)
    change.reshape(2, -1)[:, here] = (share.ravel()[here, None] * (found - before)).T
    shown = skin.shown(found)
    changes, weight = skin.changes(found, shown), np.full_like(shown, INTENSITY_SIGMA**-2)
    moves = np.zeros((2, len(quadric.folds), *size), np.float32)
    for number, fold in enumerate(quadric.folds):
        less = shown - fold.at(*places).shown(found)
        move = gauss_newton_step(changes, weight, less, np.zeros_like(found), SURFACE_SIGMA)
        moves[:, number].reshape(2, -1)[:, here] = move.T
    unsure = jackknifed(moves[0]), jackknifed(moves[1])
    nothing = np.zeros(size, np.float32)
    left_alone = (~faithful).astype(np.float32)
    return CellCorrection(change[0], change[1], nothing, nothing, nothing, cell, 1.0, unsure, left_alone)
