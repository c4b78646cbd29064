"""A height map as triangles: right-handed, x to the right, y up, z to the camera; invalid pixels are holes."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array
from host_sync.errors import ExportError
from host_sync.export.source_surface import SourceSurface, ascii_line
from host_sync.render.shading import linear_light, tint_table

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
        """Yield positions of the vertices in order, in blocks: float32 arrays of shape (N, 3), µm times `scale`."""
        rows, columns = self.z_um.shape
        across = np.arange(columns) * (self.pitch_um * scale)
        for first in range(0, rows, ROWS):
            z = self.z_um[first : first + ROWS]
            up = (rows - 1 - np.arange(first, first + z.shape[0])) * (self.pitch_um * scale)
            grid = np.stack([*np.broadcast_arrays(across[None, :], up[:, None]), z * np.float64(scale)], axis=-1)
            yield grid[np.isfinite(z)].astype(np.float32)

    def normals(self) -> Iterator[Float32Array]:
        """Yield the unit normals of the vertices in order, float32 arrays of shape (N, 3).

        Slopes next to a hole are one-sided.
        """
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
    """Return a mesh of every `step`-th row and column, heights not interpolated.

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
    """Return two triangles for each square of four vertices, int32 array (N, 3); -1 where there is no vertex."""
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    # If a or d is invalid, the other diagonal keeps one triangle.
    other = (a < 0) | (d < 0)
    first = np.where(other[..., None], np.stack([a, c, b], -1), np.stack([a, c, d], -1))
    second = np.where(other[..., None], np.stack([b, c, d], -1), np.stack([a, d, b], -1))
    return np.stack([first, second], axis=2).reshape(-1, 3)


def _slopes(z_um: Float32Array, axis: int, pitch_um: float) -> Float32Array:
    """Return slopes along an axis: central differences, one-sided beside invalid pixels, 0 without a neighbour."""
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
    """Return places of the vertices, mm, float32 array (N, 3), and vertex numbers of the triangles, shape (M, 3).

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
    """Yield the triangles in blocks, which bounds memory."""
    for first in range(0, len(faces), size):
        yield faces[first : first + size]


# Mesh formats: STL, OBJ and PLY with places in mm, GLB with places in metres.
#
# STL (binary) holds triangles with normals, but neither units nor colours. OBJ is text, with neither units nor colours
# that all readers share. PLY (binary) holds a colour for the height of each vertex.
#
# GLB is glTF 2.0 in one file: normals, and a colour for the height.


def write_stl(file: BinaryIO, mesh: Mesh, name: str, base_mm: float | None = None) -> None:
    """Write the mesh in binary STL: as an open surface, or watertight with a base of this thickness."""
    if base_mm is None:
        places, count, parts = np.concatenate(list(mesh.places(MM))), mesh.triangles, mesh.corners()
    else:
        places, faces = solid(mesh, base_mm)
        count, parts = len(faces), blocks(faces)
    # Readers take a header that begins with "solid" for text.
    said = ", ".join(part for part in ("Retrograph, mm", mesh.doubtful, name) if part)
    file.write(ascii_line(said)[:80].ljust(80))
    file.write(struct.pack("<I", count))
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    for corners in parts:
        facets = np.zeros(len(corners), facet)
        facets["corners"] = places[corners]
        sides = np.diff(places[corners].astype(np.float64), axis=1)
        normals = np.cross(sides[:, 0], sides[:, 1])
        facets["normal"] = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
        file.write(facets.tobytes())


def write_obj(file: BinaryIO, mesh: Mesh, name: str) -> None:
    """Write the mesh as Wavefront OBJ."""
    file.write(b"# %b\n# unit mm\n" % ascii_line(name))
    file.writelines(b"# doubt: %b\n" % ascii_line(doubt) for doubt in mesh.doubts)
    for places in mesh.places(MM):
        file.write((b"v %.9g %.9g %.9g\n" * len(places)) % tuple(places.ravel().tolist()))
    for corners in mesh.corners():
        file.write((b"f %d %d %d\n" * len(corners)) % tuple((corners + 1).ravel().tolist()))


PLY_HEADER: Final = """ply
format binary_little_endian 1.0
comment {name}
comment unit mm
{doubts}element vertex {vertices}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face {triangles}
property list uchar int vertex_indices
end_header
"""


def write_ply(file: BinaryIO, mesh: Mesh, name: str) -> None:
    """Write the mesh as binary PLY."""
    doubts = "".join(f"comment doubt: {doubt}\n" for doubt in mesh.doubts)
    header = PLY_HEADER.format(name=name, doubts=doubts, vertices=mesh.vertices, triangles=mesh.triangles)
    file.write(ascii_line(header))
    vertex = np.dtype([("place", "<f4", 3), ("colour", "u1", 3)])
    for places, colours in zip(mesh.places(MM), vertex_colours(mesh), strict=True):
        rows = np.empty(len(places), vertex)
        rows["place"], rows["colour"] = places, colours
        file.write(rows.tobytes())
    face = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    for corners in mesh.corners():
        faces = np.empty(len(corners), face)
        faces["count"], faces["corners"] = 3, corners
        file.write(faces.tobytes())


METRES: Final = 1e-6
FLOAT, UINT16, UINT32 = 5126, 5123, 5125
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
PLACE_BYTES, NORMAL_BYTES, COLOUR_BYTES, TRIANGLE_BYTES = 12, 12, 8, 12


def write_glb(file: BinaryIO, mesh: Mesh, name: str) -> None:
    """Write the mesh in the orientation of viewers: z towards the reader, y up."""
    places = list(mesh.places(METRES))
    limits = (
        np.min([part.min(axis=0) for part in places if len(part)], axis=0),
        np.max([part.max(axis=0) for part in places if len(part)], axis=0),
    )
    record = msgspec.json.encode(_record(mesh, name, *([float(value) for value in limit] for limit in limits)))
    record += b" " * (-len(record) % 4)
    size = mesh.vertices * (PLACE_BYTES + NORMAL_BYTES + COLOUR_BYTES) + mesh.triangles * TRIANGLE_BYTES
    file.write(b"glTF" + struct.pack("<II", 2, 12 + 8 + len(record) + 8 + size))
    file.write(struct.pack("<I", len(record)) + b"JSON" + record)
    file.write(struct.pack("<I", size) + b"BIN\0")
    _write_all(file, places)
    _write_all(file, mesh.normals())
    for colours in vertex_colours(mesh):
        rgba = np.full((len(colours), 4), 65535, "<u2")
        rgba[:, :3] = linear_light(colours)
        file.write(rgba.tobytes())
    _write_all(file, (corners.astype("<u4") for corners in mesh.corners()))


def _record(mesh: Mesh, name: str, low: list[float], high: list[float]) -> dict[str, Any]:
    """Return the JSON chunk."""
    sizes = [mesh.vertices * PLACE_BYTES, mesh.vertices * NORMAL_BYTES, mesh.vertices * COLOUR_BYTES]
    sizes.append(mesh.triangles * TRIANGLE_BYTES)
    starts = [sum(sizes[:number]) for number in range(len(sizes))]
    targets = [VERTEX_BUFFER] * 3 + [INDEX_BUFFER]
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": size, "target": target}
        for start, size, target in zip(starts, sizes, targets, strict=True)
    ]
    vertices, corners = mesh.vertices, 3 * mesh.triangles
    accessors = [
        {"bufferView": 0, "componentType": FLOAT, "count": vertices, "type": "VEC3", "min": low, "max": high},
        {"bufferView": 1, "componentType": FLOAT, "count": vertices, "type": "VEC3"},
        {"bufferView": 2, "componentType": UINT16, "normalized": True, "count": vertices, "type": "VEC4"},
        {"bufferView": 3, "componentType": UINT32, "count": corners, "type": "SCALAR"},
    ]
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0}
    surface = {"metallicFactor": 0.0, "roughnessFactor": 0.8}
    return {
        "asset": {"version": "2.0", "generator": "retrograph", "extras": {"doubts": list(mesh.doubts)}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"name": name, "primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": surface, "doubleSided": True}],
        "buffers": [{"byteLength": sum(sizes)}],
        "bufferViews": views,
        "accessors": accessors,
    }


def _write_all(file: BinaryIO, arrays: Iterable[np.ndarray[Any, Any]]) -> None:
    for array in arrays:
        file.write(array.tobytes())
