"""Formats of a height map with a fixed header: SUR, GSF, AL3D and SDF.

SUR, Digital Surf, classical: a header of 512 bytes, then int32, lengths in mm; min - 2 where not measured.

GSF, Gwyddion Simple Field 1.0: lines of text, then float32 in metres, top row first, NaN where invalid.

AL3D, Alicona, version 1: tags of 52 bytes, a comment, then float32 in metres, rows padded to 8 bytes.

SDF of ISO 25178-71, binary, ISO-1.0: 81 bytes, then float64 in µm with their scale to metres. Invalid pixels are NaN.
Gwyddion 2.62 takes the standard's own marker, the lowest number of the type, for a height of -1.8e308; it masks NaN, as
surfalize does, and no program can take NaN for a height.
"""

from __future__ import annotations

import struct
from datetime import datetime
from typing import BinaryIO, Final

import numpy as np

from host_sync.errors import ExportError
from host_sync.export.source_surface import SourceSurface, ascii_line, integer_quantum, row_blocks

UM: Final = 1e-6
UM_TO_MM: Final = 1e-3
SUR_HEADER: Final = "<12shhhh30s30shhhhhf4xhiiiiifff16s16s16s16s16s16s16s16s16sfffhhh12xhhhhhhhfI6xhh128sfffff13s13s"
SUR_SURFACE: Final = 2
STRUCTURED_LIGHT: Final = 10


def write_sur(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map in steps of 1e-9 of its highest value; the uncertainty is not written."""
    step_mm = float(np.float32(integer_quantum(surface.z_um) * UM_TO_MM))
    counts_a_um = UM_TO_MM / step_mm
    lowest, highest = (round(float(limit(surface.z_um)) * counts_a_um) for limit in (np.nanmin, np.nanmax))
    gaps = bool(np.isnan(surface.z_um).any())
    mm = b"mm"
    pitch_mm = surface.pitch_um * UM_TO_MM
    comment = ascii_line(surface.origin)[: 2**15 - 1]
    head = struct.pack(
        SUR_HEADER,
        b"DIGITAL SURF", 0, 1, 1, SUR_SURFACE,
        ascii_line(surface.name)[:30].ljust(30), b"".ljust(30),
        0, STRUCTURED_LIGHT, 0, gaps, 0, 0.0,
        32, lowest, highest, surface.columns, surface.rows, surface.z_um.size,
        pitch_mm, pitch_mm, step_mm,
        *(name.ljust(16) for name in (b"X", b"Y", b"Z", *(mm,) * 6)),
        1.0, 1.0, 1.0,
        0, 0, 0,
        *_clock(surface.written_utc),
        0.0, 0,
        len(comment), 0, b"",
        0.0, 0.0, 0.0, 0.0, 0.0, b"", b"",
    )  # fmt: skip
    file.write(head + comment)
    file.writelines(row_blocks(surface.z_um, counts_a_um, "<i4", invalid=lowest - 2))


def _clock(written_utc: str) -> tuple[int, ...]:
    """Second, minute, hour, day, month, year, day of the week (Sunday is 0); zeros when unknown."""
    try:
        at = datetime.fromisoformat(written_utc)
    except ValueError:
        return (0,) * 7
    return at.second, at.minute, at.hour, at.day, at.month, at.year, at.isoweekday() % 7


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
        "Doubts": "; ".join(surface.doubts),
    }
    text = "Gwyddion Simple Field 1.0\n" + "".join(f"{key} = {value}\n" for key, value in lines.items() if value)
    head = text.encode()
    file.write(head + b"\0" * (4 - len(head) % 4))
    file.writelines(row_blocks(surface.z_um, UM, "<f4"))


AL3D_MAGIC: Final = b"AliconaImaging\0\r\n"
AL3D_INVALID: Final = float(np.float32(3e15))
AL3D_COMMENT_BYTES: Final = 256
"""Including its line end."""


def write_al3d(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the depth image; the uncertainty is not written: the format's quality map means repeatability."""
    tags = {
        "Cols": surface.columns,
        "Rows": surface.rows,
        "PixelSizeXMeter": repr(surface.pitch_um * UM),
        "PixelSizeYMeter": repr(surface.pitch_um * UM),
        "InvalidPixelValue": repr(AL3D_INVALID),
        "DepthImageOffset": len(AL3D_MAGIC) + 52 * 11 + AL3D_COMMENT_BYTES,
        "TextureImageOffset": 0,
        "NumberOfPlanes": 0,
        "IconOffset": 0,
    }
    said = (surface.doubtful, surface.name, surface.origin)
    comment = ascii_line("; ".join(part for part in said if part))[: AL3D_COMMENT_BYTES - 3]
    file.write(AL3D_MAGIC)
    for key, value in {"Version": 1, "TagCount": len(tags), **tags}.items():
        file.write(struct.pack("20s30s2s", key.encode(), str(value).encode(), b"\r\n"))
    file.write(comment.ljust(AL3D_COMMENT_BYTES - 2, b"\0") + b"\r\n")
    file.writelines(row_blocks(surface.z_um, UM, "<f4", invalid=AL3D_INVALID, padding=-4 * surface.columns % 8))


SDF_DOUBLE: Final = 7
SDF_MAX_POINTS: Final = 2**16 - 1


def write_sdf(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map; the uncertainty is not written.

    Raises
    ------
    ExportError
        The field has more rows or columns than the format allows.
    """
    if max(surface.z_um.shape) > SDF_MAX_POINTS:
        raise ExportError(
            f"{surface.name}: SDF ends at {SDF_MAX_POINTS} and the field is {surface.columns}x{surface.rows}: use x3p"
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
            SDF_DOUBLE,
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
