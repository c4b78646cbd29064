"""Whether an image file is all there, from its skeleton: a cut file is found before minutes of work, not after."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO, Final

import tifffile

from device.tiff_reading import TIFF_READ_ERRORS, quiet_tiff_log
from host_sync.jpeg import has_end

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
_MOST_CHUNKS: Final = 100_000


def ends_well(path: Path) -> bool:
    """Whether a PNG, JPEG or TIFF goes on to the end that it claims.

    Raises
    ------
    OSError
        It cannot be read.
    """
    with path.open("rb") as stream:
        start = stream.read(len(_PNG))
        if start == _PNG:
            return _png_ends(stream)
        if start.startswith(_JPEG):
            return has_end(start + stream.read())
    return _tiff_ends(path)


def _png_ends(stream: BinaryIO) -> bool:
    """Whether the chunks go on, each as long as it says, to the last."""
    size = stream.seek(0, 2)
    at = len(_PNG)
    for _ in range(_MOST_CHUNKS):
        stream.seek(at)
        head = stream.read(8)
        if len(head) < 8:
            return False
        length, kind = struct.unpack(">I4s", head)
        at += 12 + length
        if at > size:
            return False
        if kind == b"IEND":
            return True
    return False


def _tiff_ends(path: Path) -> bool:
    """Whether every strip or tile of the first page lies inside the file."""
    size = path.stat().st_size
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            page = tiff.pages.first
            spans = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    except TIFF_READ_ERRORS:
        return False
    return bool(spans) and all(offset > 0 and offset + count <= size for offset, count in spans)
