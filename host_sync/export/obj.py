"""Wavefront OBJ: text, places in mm; the format has neither units nor colours that all readers share."""

from __future__ import annotations

from typing import BinaryIO, Final

from host_sync.export.mesh import Mesh
from host_sync.export.source_surface import ascii_line

MM: Final = 1e-3


def write_obj(file: BinaryIO, mesh: Mesh, name: str) -> None:
    """Write the mesh."""
    file.write(b"# %b\n# unit mm\n" % ascii_line(name))
    for places in mesh.places(MM):
        file.write((b"v %.9g %.9g %.9g\n" * len(places)) % tuple(places.ravel().tolist()))
    for corners in mesh.corners():
        file.write((b"f %d %d %d\n" * len(corners)) % tuple((corners + 1).ravel().tolist()))
