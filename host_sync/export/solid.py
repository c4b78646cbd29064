"""A mesh made solid for printing: a flat base below it, and walls around its border and its holes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array
from host_sync.errors import ExportError
from host_sync.export.mesh import Mesh

MM: Final = 1e-3
MAX_BASE_MM: Final = 1000.0


def solid(mesh: Mesh, base_mm: float) -> tuple[Float32Array, NDArray[np.int32]]:
    """Places of the vertices, mm, float32 array of shape (N, 3), and vertex numbers of the triangles, shape (M, 3).

    Every edge belongs to exactly two triangles. Where two holes touch at a corner, the triangles around it are left
    out.

    base_mm : thickness of the base below the lowest point

    Raises
    ------
    ExportError
        The base has no thickness, or no triangle is left.
    """
    if not 0.0 < base_mm <= MAX_BASE_MM:
        raise ExportError(f"a base is up to {MAX_BASE_MM:g} mm thick, got {base_mm:g}: choose --base-mm 2, for example")
    top = np.concatenate(list(mesh.places(MM)))
    corners = np.concatenate(list(mesh.corners())).astype(np.int64)
    count = len(top)
    while True:
        border = _border(corners, count)
        pinched = np.flatnonzero(np.bincount(border[:, 0], minlength=count) > 1)
        if not pinched.size:
            break
        corners = corners[~np.isin(corners, pinched).any(axis=1)]
    if not len(corners):
        raise ExportError("no triangle is left for a solid: fill the holes first, or choose a smaller mesh step")
    floor = np.full_like(top[:, 2], top[np.unique(corners), 2].min() - base_mm)
    below = np.column_stack([top[:, :2], floor]).astype(np.float32)
    first, second = border.T
    upper = np.stack([second, first, first + count], axis=-1)
    lower = np.stack([second, first + count, second + count], axis=-1)
    faces = np.concatenate([corners, corners[:, ::-1] + count, upper, lower])
    return np.concatenate([top, below]), faces.astype(np.int32)


def _border(corners: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Directed edges that only one triangle has: int64 array of shape (N, 2)."""
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    own, other = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    return np.asarray(edges[~np.isin(own, other)], np.int64)


def blocks(faces: NDArray[np.int32], size: int = 65_536) -> Iterator[NDArray[np.int32]]:
    """The triangles in blocks, which bounds memory."""
    for first in range(0, len(faces), size):
        yield faces[first : first + size]
