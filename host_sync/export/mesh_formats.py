"""Mesh formats: STL, OBJ and PLY with places in mm, GLB with places in metres.

STL (binary) holds triangles with normals, but neither units nor colours. OBJ is text, with neither units nor colours
that all readers share. PLY (binary) holds a colour for the height of each vertex.

GLB is glTF 2.0 in one file: normals, and a colour for the height.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any, BinaryIO, Final

import msgspec
import numpy as np

from host_sync.export.mesh import Mesh, blocks, solid, vertex_colours
from host_sync.export.source_surface import ascii_line
from host_sync.render.colormap import linear_light

MM: Final = 1e-3


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
    """The JSON chunk."""
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
