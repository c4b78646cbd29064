"""A height map as triangles: right-handed, x to the right, y up, z to the camera; invalid pixels are holes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array
from host_sync.errors import ExportError
from host_sync.export.source_surface import SourceSurface
from host_sync.render.colormap import tint_table

MAX_VERTICES: Final = 2_000_000
"""Most triangles of a mesh: 200 MB of STL, which common viewers still display."""
ROWS: Final = 64


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A grid of vertices; a vertex among invalid pixels may belong to no triangle.

    z_um : float32 array of shape (H, W), µm, NaN where invalid
    pitch_um : vertex spacing, µm
    index : int32 array of shape (H, W), number of the vertex, -1 where invalid
    doubts : reasons to distrust the heights, one printable line each
    doubtful : the same in a few words
    """

    z_um: Float32Array
    pitch_um: float
    index: NDArray[np.int32]
    vertices: int
    triangles: int
    doubts: tuple[str, ...] = ()
    doubtful: str = ""

    def places(self, scale: float) -> Iterator[Float32Array]:
        """Positions of the vertices in order, in blocks: float32 arrays of shape (N, 3), µm times `scale`."""
        rows, columns = self.z_um.shape
        across = np.arange(columns) * (self.pitch_um * scale)
        for first in range(0, rows, ROWS):
            z = self.z_um[first : first + ROWS]
            up = (rows - 1 - np.arange(first, first + z.shape[0])) * (self.pitch_um * scale)
            grid = np.stack([*np.broadcast_arrays(across[None, :], up[:, None]), z * np.float64(scale)], axis=-1)
            yield grid[np.isfinite(z)].astype(np.float32)

    def normals(self) -> Iterator[Float32Array]:
        """Unit normals of the vertices in order, float32 arrays of shape (N, 3); slopes beside a hole are one-sided."""
        rows = self.z_um.shape[0]
        for first in range(0, rows, ROWS):
            last = min(first + ROWS, rows)
            top = max(first - 1, 0)
            z = self.z_um[top : min(last + 1, rows)]
            p, q = (_slopes(z, axis, self.pitch_um)[first - top : last - top] for axis in (1, 0))
            # y points up and rows count down: the slope along y is -q.
            normal = np.stack([-p, q, np.ones_like(p)], axis=-1)
            normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
            yield normal[np.isfinite(self.z_um[first:last])].astype(np.float32)

    def corners(self) -> Iterator[NDArray[np.int32]]:
        """Vertex numbers of the triangles, int32 arrays of shape (N, 3), counter-clockwise as seen from above."""
        for first in range(0, self.index.shape[0] - 1, ROWS):
            both = _triangles(self.index[first : first + ROWS + 1])
            yield both[(both >= 0).all(axis=-1)]


def grid_mesh(surface: SourceSurface, step: int | None) -> Mesh:
    """A mesh of every `step`-th row and column, heights not interpolated.

    step : None takes every pixel and refuses a field that has too many

    Raises
    ------
    ExportError
        The mesh would be too large, or have no triangle.
    """
    if step is not None and step < 1:
        raise ExportError(f"mesh step must be at least 1, got {step}")
    check_mesh_size(surface, step)
    z_um = np.ascontiguousarray(surface.z_um[:: step or 1, :: step or 1])
    valid = np.isfinite(z_um)
    vertices = int(valid.sum())
    index = np.where(valid, np.cumsum(valid, dtype=np.int32).reshape(valid.shape) - 1, np.int32(-1)).astype(np.int32)
    mesh = Mesh(z_um, surface.pitch_um * (step or 1), index, vertices, 0)
    triangles = sum(len(corners) for corners in mesh.corners())
    if triangles == 0:
        raise ExportError(f"{surface.name}: no three neighbouring pixels are valid: choose a smaller mesh step")
    return Mesh(z_um, mesh.pitch_um, index, vertices, triangles, surface.doubts, surface.doubtful)


def check_mesh_size(surface: SourceSurface, step: int | None) -> None:
    """Check that a mesh of every `step`-th row and column is small enough.

    Raises
    ------
    ExportError
        It is too large; the message names a sufficient step.
    """
    rows, columns = (math.ceil(size / (step or 1)) for size in surface.z_um.shape)
    if rows * columns > MAX_VERTICES:
        enough = math.ceil(math.sqrt(surface.z_um.size / MAX_VERTICES))
        while math.ceil(surface.rows / enough) * math.ceil(surface.columns / enough) > MAX_VERTICES:
            enough += 1
        raise ExportError(
            f"{surface.name}: a mesh of {columns}x{rows} pixels has {2 * rows * columns / 1e6:.0f} million triangles, "
            f"more than most programs open: add --mesh-step {enough}, which keeps one row and column in {enough}"
        )


def _triangles(index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Two triangles for each square of four vertices, int32 array of shape (N, 3); -1 where there is no vertex."""
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    # If a or d is invalid, the other diagonal keeps one triangle.
    other = (a < 0) | (d < 0)
    first = np.where(other[..., None], np.stack([a, c, b], -1), np.stack([a, c, d], -1))
    second = np.where(other[..., None], np.stack([b, c, d], -1), np.stack([a, d, b], -1))
    return np.stack([first, second], axis=2).reshape(-1, 3)


def _slopes(z_um: Float32Array, axis: int, pitch_um: float) -> Float32Array:
    """Slopes along an axis: central differences, one-sided beside invalid pixels, 0 without a neighbour."""
    step = np.diff(z_um, axis=axis) / np.float32(pitch_um)
    edge = np.full_like(np.take(z_um, [0], axis), np.nan)
    sides = np.stack([np.concatenate([edge, step], axis), np.concatenate([step, edge], axis)])
    known = np.isfinite(sides)
    mean: Float32Array = np.where(known, sides, np.float32(0)).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return mean.astype(np.float32)


def vertex_colours(mesh: Mesh) -> Iterator[NDArray[np.uint8]]:
    """sRGB of the vertices in order, in blocks: uint8 arrays of shape (N, 3), from the 1st to the 99th percentile."""
    low, high = np.nanpercentile(mesh.z_um, [1.0, 99.0])
    span = float(high - low) or 1.0
    palette = np.rint(tint_table()).astype(np.uint8)
    for first in range(0, mesh.z_um.shape[0], ROWS):
        z = mesh.z_um[first : first + ROWS]
        shade = np.clip((z[np.isfinite(z)] - low) / span * 255.0, 0.0, 255.0)
        yield palette[np.rint(shade).astype(np.uint8)]


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
