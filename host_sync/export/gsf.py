"""Gwyddion Simple Field 1.0: lines of text, then float32 in metres, top row first, NaN where invalid."""

from __future__ import annotations

from typing import BinaryIO

from host_sync.export.row_blocks import row_blocks
from host_sync.export.source_surface import SourceSurface

UM = 1e-6


def write_gsf(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map; the format has one field, so the uncertainty is not written."""
    lines = {
        "XRes": surface.columns,
        "YRes": surface.rows,
        "XReal": repr(surface.columns * surface.pitch_um * UM),
        "YReal": repr(surface.rows * surface.pitch_um * UM),
        "XYUnits": "m",
        "ZUnits": "m",
        "Title": surface.name,
        "Origin": surface.origin,
    }
    text = "Gwyddion Simple Field 1.0\n" + "".join(f"{key} = {value}\n" for key, value in lines.items() if value)
    head = text.encode()
    file.write(head + b"\0" * (4 - len(head) % 4))
    file.writelines(row_blocks(surface.z_um, UM, "<f4"))
