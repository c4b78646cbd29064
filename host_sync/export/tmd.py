"""GelSight's TMD, version 2: a magic line, a comment, sizes, lengths in mm, float32 heights in mm, top row first.

Lengths are the pitch times the number of columns or rows. The format defines no value for invalid pixels; they are NaN,
which no reader takes for a height.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from device.io.system import explain_os_error
from host_sync.errors import ExportError
from host_sync.export.source_surface import (
    SourceSurface,
    ascii_line,
    checked_surface,
    doubts_path,
    one_line,
    row_blocks,
)

MAGIC: Final = b"Binary TrueMap Data File v2.0\r\n\0"
ANY_VERSION: Final = b"Binary TrueMap Data File"
UM_TO_MM: Final = 1e-3
SIZES: Final = "<IIffff"
MARKED: Final = "Retrograph, DOUBTFUL"
"""Comment of a surface that has doubts; their reasons lie in a text file beside it."""

COMMENT_BYTES: Final = 21
"""Of the comment that GelSight's own program writes; surfalize reads files with this length only."""

UNNAMED: Final = "doubtful"
MAX_DOUBTS_BYTES: Final = 65_536
MAX_COMMENT_BYTES: Final = 4096
MAX_PIXELS: Final = 2**31
SQUARE: Final = 1e-3
"""Relative tolerance between column and row pitch: lengths are float32."""


def write_tmd(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map; neither uncertainty nor name nor the doubts' reasons are written."""
    comment = ascii_line(MARKED if surface.doubts else "Retrograph")
    file.write(MAGIC + comment.ljust(COMMENT_BYTES) + b"\r\n\0")
    lengths_mm = (surface.columns * surface.pitch_um * UM_TO_MM, surface.rows * surface.pitch_um * UM_TO_MM)
    file.write(struct.pack(SIZES, surface.columns, surface.rows, *lengths_mm, 0.0, 0.0))
    file.writelines(row_blocks(surface.z_um, UM_TO_MM, "<f4"))


def read_tmd(path: Path) -> SourceSurface:
    """Return the surface in a TMD file of version 2, with the doubts that it was written with.

    The name of the surface is that of the file.

    Raises
    ------
    ExportError
        It is not a TMD file, is damaged, or its pixels are not square.
    """
    try:
        with path.open("rb") as file:
            head = file.read(len(MAGIC) + MAX_COMMENT_BYTES + struct.calcsize(SIZES))
        size = path.stat().st_size
    except OSError as error:
        raise ExportError(f"{path}: cannot be read {explain_os_error(error)}") from error
    if not head.startswith(MAGIC):
        what = "is a TMD file of another version" if head.startswith(ANY_VERSION) else "is no TMD file"
        raise ExportError(f"{path}: {what}: name one of version 2.0")
    end = head.find(b"\0", len(MAGIC), len(MAGIC) + MAX_COMMENT_BYTES)
    start = end + 1 + struct.calcsize(SIZES)
    if end < 0 or len(head) < start:
        raise ExportError(f"{path}: ends before its sizes do: copy it again")
    columns, rows, across_mm, down_mm, _, _ = struct.unpack_from(SIZES, head, end + 1)
    if not 0 < columns * rows <= MAX_PIXELS or size < start + 4 * columns * rows:
        raise ExportError(f"{path}: is too short for the {columns}x{rows} pixels that it declares: copy it again")
    pitch_um, down_um = across_mm / columns / UM_TO_MM, down_mm / rows / UM_TO_MM
    if not abs(pitch_um - down_um) <= SQUARE * abs(pitch_um):
        raise ExportError(f"{path}: its pixels are {pitch_um:g} x {down_um:g} um: export one with square pixels")
    z_um = np.fromfile(path, "<f4", columns * rows, offset=start).reshape(rows, columns)
    z_um /= np.float32(UM_TO_MM)
    comment = head[len(MAGIC) : end].decode("ascii", "replace").strip()
    doubts = _doubts_beside(path) if comment == MARKED else ()
    surface = SourceSurface(
        name=path.stem,
        z_um=z_um.astype(np.float32, copy=False),
        pitch_um=pitch_um,
        origin=one_line("; ".join(("TMD file", comment, *doubts))),
        doubts=doubts,
        short_doubts=tuple(dict.fromkeys(doubt.partition(":")[0] for doubt in doubts)),
    )
    return checked_surface(surface, path)


def _doubts_beside(path: Path) -> tuple[str, ...]:
    """Return the doubts in the text file beside a marked file; one that names the mark where there is none."""
    try:
        text = doubts_path(path).read_bytes()[:MAX_DOUBTS_BYTES].decode(errors="replace")
    except OSError:
        text = ""
    found = tuple(one_line(line) for line in text.splitlines()[1:] if line.strip())
    return found or (f"{UNNAMED}: the file is marked, and {doubts_path(path).name} with the reasons is not next to it",)
