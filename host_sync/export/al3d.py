"""Alicona's AL3D, version 1: tags of 52 bytes, a comment, then float32 in metres, rows padded to 8 bytes."""

from __future__ import annotations

import struct
from typing import BinaryIO, Final

import numpy as np

from host_sync.export.row_blocks import row_blocks
from host_sync.export.source_surface import SourceSurface, ascii_line

UM: Final = 1e-6
MAGIC: Final = b"AliconaImaging\0\r\n"
INVALID: Final = float(np.float32(3e15))
COMMENT_BYTES: Final = 256
"""Including its line end."""


def write_al3d(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the depth image; the uncertainty is not written: the format's quality map means repeatability."""
    tags = {
        "Cols": surface.columns,
        "Rows": surface.rows,
        "PixelSizeXMeter": repr(surface.pitch_um * UM),
        "PixelSizeYMeter": repr(surface.pitch_um * UM),
        "InvalidPixelValue": repr(INVALID),
        "DepthImageOffset": len(MAGIC) + 52 * 11 + COMMENT_BYTES,
        "TextureImageOffset": 0,
        "NumberOfPlanes": 0,
        "IconOffset": 0,
    }
    comment = ascii_line(f"{surface.name}; {surface.origin}")[: COMMENT_BYTES - 3]
    file.write(MAGIC)
    for key, value in {"Version": 1, "TagCount": len(tags), **tags}.items():
        file.write(struct.pack("20s30s2s", key.encode(), str(value).encode(), b"\r\n"))
    file.write(comment.ljust(COMMENT_BYTES - 2, b"\0") + b"\r\n")
    file.writelines(row_blocks(surface.z_um, UM, "<f4", invalid=INVALID, padding=-4 * surface.columns % 8))
