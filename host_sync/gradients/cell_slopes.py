"""Slopes that a map reads of mean intensity over cells, whose noise is as many times less as a cell has pixels.

A single pixel's noise passes through a curved map and adds to its mean slope; over a contact that sums up to height.
"""

from __future__ import annotations

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import GradientField
from host_sync.kernels.cell_rows import WHOLE_CELL, means_of_cells, middles_of_cells


def cell_slopes(image: NormalizedImage, inverse_map: InverseMap, cell: int) -> GradientField:
    """Return the slopes of cells of `cell` x `cell` pixels, shape (h, w).

    Beyond the field its last row and column are repeated. A cell of which more than a thousandth is invalid is invalid:
    its slope and weight are 0.
    """
    size = -(-image.shape[0] // cell), -(-image.shape[1] // cell)
    valid = means_of_cells(image.valid.astype(np.float32)[..., None], size, cell)[..., 0] > WHOLE_CELL
    row, column = middles_of_cells(size, cell)
    means = np.nan_to_num(means_of_cells(image.values, size, cell), nan=1.0).astype(np.float32)
    slopes = np.where(valid[..., None], inverse_map.on_grid(means, column, row), np.float32(0.0))
    p, q = (np.ascontiguousarray(slopes[..., axis]) for axis in (0, 1))
    return GradientField(p, q, valid, valid.astype(np.float32))
