"""Mesh formats: STL, OBJ and PLY, places in mm.

STL (binary) holds triangles with normals, but neither units nor colours. OBJ is text, with neither units nor colours
that all readers share. PLY (binary) holds a colour for the height of each vertex.
"""

from __future__ import annotations

import struct
from typing import BinaryIO, Final

import numpy as np

from host_sync.export.mesh import Mesh, vertex_colours
from host_sync.export.source_surface import ascii_line

MM: Final = 1e-3


def write_stl(file: BinaryIO, mesh: Mesh, name: str) -> None:
    """Write the mesh as an open surface in binary STL."""
    # Readers take a header that begins with "solid" for text.
    file.write(ascii_line(f"Retrograph, mm, {name}")[:80].ljust(80))
    file.write(struct.pack("<I", mesh.triangles))
    places = np.concatenate(list(mesh.places(MM)))
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    for corners in mesh.corners():
        facets = np.zeros(len(corners), facet)
        facets["corners"] = places[corners]
        sides = np.diff(places[corners].astype(np.float64), axis=1)
        normals = np.cross(sides[:, 0], sides[:, 1])
        facets["normal"] = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
        file.write(facets.tobytes())


def write_obj(file: BinaryIO, mesh: Mesh, name: str) -> None:
    """Write the mesh as Wavefront OBJ."""
    file.write(b"# %b\n# unit mm\n" % ascii_line(name))
    for places in mesh.places(MM):
        file.write((b"v %.9g %.9g %.9g\n" * len(places)) % tuple(places.ravel().tolist()))
    for corners in mesh.corners():
        file.write((b"f %d %d %d\n" * len(corners)) % tuple((corners + 1).ravel().tolist()))


PLY_HEADER: Final = """ply
format binary_little_endian 1.0
comment {name}
comment unit mm
element vertex {vertices}
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
    file.write(ascii_line(PLY_HEADER.format(name=name, vertices=mesh.vertices, triangles=mesh.triangles)))
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
