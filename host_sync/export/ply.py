"""PLY, binary: places in mm with a colour for the height."""

from __future__ import annotations

from typing import BinaryIO, Final

import numpy as np

from host_sync.export.height_colours import vertex_colours
from host_sync.export.mesh import Mesh
from host_sync.export.source_surface import ascii_line

MM: Final = 1e-3
HEADER: Final = """ply
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
    """Write the mesh."""
    file.write(ascii_line(HEADER.format(name=name, vertices=mesh.vertices, triangles=mesh.triangles)))
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
