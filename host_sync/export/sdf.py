"""SDF of ISO 25178-71, binary, ISO-1.0: 81 bytes, then float64 in µm with their scale to metres.

Invalid pixels are NaN. Gwyddion 2.62 takes the standard's own marker, the lowest number of the type, for a height of
-1.8e308; it masks NaN, as surfalize does, and no program can take NaN for a height.
"""

from __future__ import annotations

import struct
from datetime import datetime
from typing import BinaryIO, Final

from host_sync.errors import ExportError
from host_sync.export.row_blocks import row_blocks
from host_sync.export.source_surface import SourceSurface, ascii_line

UM: Final = 1e-6
DOUBLE: Final = 7
MAX_POINTS: Final = 2**16 - 1


def write_sdf(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map; the uncertainty is not written.

    Raises
    ------
    ExportError
        The field has more rows or columns than the format allows.
    """
    if max(surface.z_um.shape) > MAX_POINTS:
        raise ExportError(
            f"{surface.name}: SDF ends at {MAX_POINTS} and the field is {surface.columns}x{surface.rows}: use x3p"
        )
    written = _moment(surface.written_utc)
    file.write(
        struct.pack(
            "<8s10s12s12sHHddddBBB",
            b"bISO-1.0",
            b"Retrograph",
            written,
            written,
            surface.columns,
            surface.rows,
            surface.pitch_um * UM,
            surface.pitch_um * UM,
            UM,
            -1.0,
            0,
            DOUBLE,
            0,
        )
    )
    file.writelines(row_blocks(surface.z_um, 1.0, "<f8"))
    file.write(b"\r\nName = %b\r\nOrigin = %b\r\n" % (ascii_line(surface.name), ascii_line(surface.origin)))


def _moment(written_utc: str) -> bytes:
    """Day, month, year, hour and minute in twelve digits; zeros when unknown."""
    try:
        return datetime.fromisoformat(written_utc).strftime("%d%m%Y%H%M").encode()
    except ValueError:
        return b"0" * 12
