"""A height map as triangles: right-handed, x to the right, y up, z to the camera; invalid pixels are holes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array
from host_sync.errors import ExportError
from host_sync.export.source_surface import SourceSurface

MOST_VERTICES: Final = 2_000_000
"""Four million triangles: 200 MB of STL, and what common viewers still turn."""
ROWS: Final = 64


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A grid of vertices, of which those beside an invalid pixel alone may belong to no triangle.

    z_um : float32 array of shape (H, W), µm, NaN where invalid
    pitch_um : from vertex to vertex, µm
    index : int32 array of shape (H, W), number of the vertex, -1 where invalid
    """

    z_um: Float32Array
    pitch_um: float
    index: NDArray[np.int32]
    vertices: int
    triangles: int

    def places(self, scale: float) -> Iterator[Float32Array]:
        """Places of the vertices in order, some at a time: float32 arrays of shape (N, 3), µm times `scale`."""
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
            # y grows upwards where rows grow downwards: the slope along y is -q.
            normal = np.stack([-p, q, np.ones_like(p)], axis=-1)
            normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
            yield normal[np.isfinite(self.z_um[first:last])].astype(np.float32)

    def corners(self) -> Iterator[NDArray[np.int32]]:
        """Vertex numbers of the triangles, int32 arrays of shape (N, 3), counter-clockwise as seen by the camera."""
        for first in range(0, self.index.shape[0] - 1, ROWS):
            both = _triangles(self.index[first : first + ROWS + 1])
            yield both[(both >= 0).all(axis=-1)]


def grid_mesh(surface: SourceSurface, step: int | None) -> Mesh:
    """Every `step`-th row and column as a mesh, heights untouched.

    step : None takes every pixel and refuses a field that has too many

    Raises
    ------
    ExportError
        The mesh would be too large, or nothing of it would be left.
    """
    if step is not None and step < 1:
        raise ExportError(f"a mesh step of {step} is none: give 1 or more")
    check_mesh_size(surface, step)
    z_um = np.ascontiguousarray(surface.z_um[:: step or 1, :: step or 1])
    valid = np.isfinite(z_um)
    vertices = int(valid.sum())
    index = np.where(valid, np.cumsum(valid, dtype=np.int32).reshape(valid.shape) - 1, np.int32(-1)).astype(np.int32)
    mesh = Mesh(z_um, surface.pitch_um * (step or 1), index, vertices, 0)
    triangles = sum(len(corners) for corners in mesh.corners())
    if triangles == 0:
        raise ExportError(f"{surface.name}: no three pixels beside each other are valid: a mesh needs a smaller step")
    return Mesh(z_um, mesh.pitch_um, index, vertices, triangles)


def check_mesh_size(surface: SourceSurface, step: int | None) -> None:
    """Nothing, if a mesh of every `step`-th row and column is small enough.

    Raises
    ------
    ExportError
        It is too large; names the step that is enough.
    """
    rows, columns = (math.ceil(size / (step or 1)) for size in surface.z_um.shape)
    if rows * columns > MOST_VERTICES:
        enough = math.ceil(math.sqrt(surface.z_um.size / MOST_VERTICES))
        while math.ceil(surface.rows / enough) * math.ceil(surface.columns / enough) > MOST_VERTICES:
            enough += 1
        raise ExportError(
            f"{surface.name}: a mesh of {columns}x{rows} pixels has {2 * rows * columns / 1e6:.0f} million triangles, "
            f"more than most programs open: add --mesh-step {enough}, which keeps one row and column in {enough}"
        )


def _triangles(index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Two triangles for each square of four vertices, int32 array of shape (N, 3); -1 where there is no vertex."""
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    # Where a is not there the other diagonal saves one triangle of three, likewise d.
    other = (a < 0) | (d < 0)
    first = np.where(other[..., None], np.stack([a, c, b], -1), np.stack([a, c, d], -1))
    second = np.where(other[..., None], np.stack([b, c, d], -1), np.stack([a, d, b], -1))
    return np.stack([first, second], axis=2).reshape(-1, 3)


def _slopes(z_um: Float32Array, axis: int, pitch_um: float) -> Float32Array:
    """Slopes along an axis: central differences, one-sided beside what is invalid, 0 without a neighbour."""
    step = np.diff(z_um, axis=axis) / np.float32(pitch_um)
    edge = np.full_like(np.take(z_um, [0], axis), np.nan)
    sides = np.stack([np.concatenate([edge, step], axis), np.concatenate([step, edge], axis)])
    known = np.isfinite(sides)
    mean: Float32Array = np.where(known, sides, np.float32(0)).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return mean.astype(np.float32)
