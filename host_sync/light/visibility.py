"""Fraction of each source's light that reaches the cells of a surface: rays to the points of its strip.

The height of skin on a ray is not sure, so that a ray that grazes it is partly open. What a cell's own plane hides
follows from the cosine law and hides nothing here: a slope that is estimated too steep would hide the light that
corrects it.
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, Float64Array, HeightMap, surface_slopes
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.light.model import POINT_WEIGHTS, LightModel

HALF_SHADOW: Final = 0.05
"""Tangent by which a ray clears cells where all of its light arrives, and by which it fails to where none does: sources
are not points, and cells round edges off."""

OVER_OWN_PLANE: Final = 0.05
"""Tangent by which skin on the way stands over a cell's own plane where it hides as much of a source as rays show."""

STRIDE: Final = 4
"""Cells that a ray passes at once where no skin around comes near it."""

WORK: Final = 200
"""Pixels of a field whose kernels take as long as the rays of one cell."""


def visible_fraction(z_px: Float32Array, cell: int, model: LightModel) -> Float64Array:
    """Return how much of each source's light arrives, 0 to 1: float64 array of shape (h, w, S).

    z_px : elevation of cells of `cell` x `cell` pixels of the model's field, shape (h, w), at least (2, 2); finite
    """
    p, q = surface_slopes(HeightMap(z_px, float(cell)))
    points = model.geometry[0][..., :3] * model.shape[1]
    visible = np.empty((*z_px.shape, len(points)))
    grid = float(cell), 0.5 * (cell - model.shape[1]), 0.5 * (cell - model.shape[0])
    around = cv2.dilate(z_px, np.ones((2 * STRIDE + 3, 2 * STRIDE + 3), np.uint8))
    work = z_px.shape[0], WORK * z_px.shape[1]
    parallel_rows(_write_visible, work, z_px, p, q, around, points, POINT_WEIGHTS, grid, visible)
    return visible


@njit(cache=True, nogil=True, error_model="numpy")
def _write_visible(
    z: Any, p: Any, q: Any, around: Any, points: Any, weights: Any, grid: Any, visible: Any, first: int, last: int
) -> None:
    """Write what arrives of sources into the rows `first` to `last` - 1 of `visible`, (h, w, S).

    around : the highest of cells up to `STRIDE` + 1 rows and columns away, shape (h, w)
    points : of each source, pixels from the middle of the field, shape (S, points, 3)
    grid : pixels along a cell; column and row of the middle of the first one from the middle of the field
    """
    cell, left, upper = grid
    rows, columns = z.shape
    top = float(around.max())
    for i in range(first, last):
        for j in range(columns):
            own_z, x, y = z[i, j], left + j * cell, upper + i * cell
            for source in range(points.shape[0]):
                visible[i, j, source] = 0.0
                for point in range(points.shape[1]):
                    across, down = points[source, point, 0] - x, points[source, point, 1] - y
                    distance = max(np.sqrt(across * across + down * down), 1e-3)
                    across, down = across / distance, down / distance
                    rise = max(points[source, point, 2] - own_z, 1.0) / distance
                    clear, step = HALF_SHADOW, 1
                    # Farther on even the highest skin comes near no ray.
                    while step * cell < distance and rise - (top - own_z) / (step * cell) < clear:
                        column, row = j + step * across, i + step * down
                        if not (0.0 <= column <= columns - 1 and 0.0 <= row <= rows - 1):
                            break
                        c, r = min(int(column), columns - 2), min(int(row), rows - 2)
                        if max(around[r, c] - own_z, 0.0) <= (rise - clear) * step * cell:
                            step += STRIDE
                            continue
                        u, v = column - c, row - r
                        met = (1.0 - v) * ((1.0 - u) * z[r, c] + u * z[r, c + 1])
                        met += v * ((1.0 - u) * z[r + 1, c] + u * z[r + 1, c + 1])
                        clear = min(clear, rise - (met - own_z) / (step * cell))
                        step += 1
                    passes = min(max((clear + HALF_SHADOW) / (2.0 * HALF_SHADOW), 0.0), 1.0)
                    own = rise - (p[i, j] * across + q[i, j] * down)
                    in_the_way = min(max((own - clear) / OVER_OWN_PLANE, 0.0), 1.0)
                    visible[i, j, source] += weights[point] * (1.0 - (1.0 - passes) * in_the_way)
