"""STL, binary: triangles in mm with their normals; the format has neither units nor colours."""

from __future__ import annotations

import struct
from typing import BinaryIO, Final

import numpy as np

from host_sync.export.mesh import Mesh
from host_sync.export.source_surface import ascii_line

MM: Final = 1e-3


def write_stl(file: BinaryIO, mesh: Mesh, name: str) -> None:
    """Write the mesh as an open surface."""
    # A header that began with "solid" would be taken for text.
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
