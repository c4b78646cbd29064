"""Digital Surf's SUR, classical: a header of 512 bytes, then int32, lengths in mm; min - 2 where not measured."""

from __future__ import annotations

import struct
from datetime import datetime
from typing import BinaryIO, Final

import numpy as np

from host_sync.export.row_blocks import integer_quantum, row_blocks
from host_sync.export.source_surface import SourceSurface, ascii_line

UM_TO_MM: Final = 1e-3
HEADER: Final = "<12shhhh30s30shhhhhf4xhiiiiifff16s16s16s16s16s16s16s16s16sfffhhh12xhhhhhhhfI6xhh128sfffff13s13s"
SURFACE: Final = 2
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
        HEADER,
        b"DIGITAL SURF", 0, 1, 1, SURFACE,
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
