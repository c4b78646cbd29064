"""Software rasterizer with a depth buffer for a grid of coloured points.

The picture is drawn at twice the size in each direction and averaged, for smooth edges.
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from host_sync.kernels.jit import njit
from host_sync.render.relief import Picture
from host_sync.render.viewpoint import Projected

OVERSAMPLING: Final = 2


def rasterize_mesh(points: Projected, colours: Picture, background: tuple[int, int, int] = (255, 255, 255)) -> Picture:
    """Picture of shape (rows, columns, 3) of the surface between the points.

    points : their positions on a picture `OVERSAMPLING` times as large in each direction
    colours : uint8 array of shape (H, W, 3), R, G, B of each point
    """
    rows, columns = points.shape
    large = np.empty((rows, columns, 3), np.uint8)
    large[:] = background
    nearest = np.full((rows, columns), np.inf, np.float32)
    _draw(points.x, points.y, points.depth, np.ascontiguousarray(colours), nearest, large)
    size = (max(1, columns // OVERSAMPLING), max(1, rows // OVERSAMPLING))
    return np.asarray(cv2.resize(large, size, interpolation=cv2.INTER_AREA), np.uint8)


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(x: Any, y: Any, depth: Any, colours: Any, nearest: Any, picture: Any) -> None:
    """Draw two triangles per cell, where their corners are valid."""
    rows, columns = x.shape
    for r in range(rows - 1):
        for c in range(columns - 1):
            _triangle(x, y, depth, colours, r, c, r + 1, c, r, c + 1, nearest, picture)
            _triangle(x, y, depth, colours, r + 1, c + 1, r, c + 1, r + 1, c, nearest, picture)


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle(
    x: Any, y: Any, depth: Any, colours: Any,
    ra: Any, ca: Any, rb: Any, cb: Any, rc: Any, cc: Any,
    nearest: Any, picture: Any,
) -> None:  # fmt: skip
    """One triangle, its colour between those of its corners."""
    xa, ya, xb, yb, xc, yc = x[ra, ca], y[ra, ca], x[rb, cb], y[rb, cb], x[rc, cc], y[rc, cc]
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    if not np.isfinite(area) or area == 0.0:
        return
    rows, columns = nearest.shape
    top = max(int(np.ceil(min(ya, yb, yc) - 0.5)), 0)
    bottom = min(int(np.floor(max(ya, yb, yc) - 0.5)), rows - 1)
    left = max(int(np.ceil(min(xa, xb, xc) - 0.5)), 0)
    right = min(int(np.floor(max(xa, xb, xc) - 0.5)), columns - 1)
    for row in range(top, bottom + 1):
        py = row + np.float32(0.5)
        for column in range(left, right + 1):
            px = column + np.float32(0.5)
            b = ((px - xa) * (yc - ya) - (xc - xa) * (py - ya)) / area
            c = ((xb - xa) * (py - ya) - (px - xa) * (yb - ya)) / area
            a = np.float32(1.0) - b - c
            if a < -1e-5 or b < -1e-5 or c < -1e-5:
                continue
            far = a * depth[ra, ca] + b * depth[rb, cb] + c * depth[rc, cc]
            if far < nearest[row, column]:
                nearest[row, column] = far
                for k in range(3):
                    mixed = a * colours[ra, ca, k] + b * colours[rb, cb, k] + c * colours[rc, cc, k]
                    picture[row, column, k] = np.uint8(min(max(mixed, 0.0), 255.0) + 0.5)
