"""Fonts of the Linux console: which glyphs the screens draw on it, and which a font file contains."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Iterable, Iterator
from itertools import takewhile
from pathlib import Path

SCREEN_FONTS = ("FullGreek-Terminus16", "FullGreek-Terminus12x6")
"""Those in docs/screens.md; the first is that of retroscan-tui.service."""

DRAWN = set(" ▀▄█▌▐░▒▓─│┌┐└┘├┤┼■·•○▲▼←↑→↓…±µ°×") | {chr(code) for code in range(32, 127)}
"""Glyphs allowed with sixteen colours or none."""

FOLDER = Path("/usr/share/consolefonts")
_FIRST, _SECOND = b"\x36\x04", b"\x72\xb5\x4a\x86"
_END, _SEQUENCE = 0xFFFF, 0xFFFE


def glyphs_of(font: Path) -> set[str]:
    """Characters of a PSF font of version 1 (8 pixels wide) or 2, without sequences of several code points."""
    data = gzip.decompress(font.read_bytes())
    if data[:2] == _FIRST:
        count = 512 if data[2] & 1 else 256
        return set(_by_words(memoryview(data)[4 + count * data[3] :].cast("H"), count))
    if data[:4] == _SECOND:
        header, _, count, size = struct.unpack_from("<4I", data, 8)
        entries = data[header + count * size :].split(b"\xff")[:count]
        return set().union(*(entry.split(b"\xfe")[0].decode() for entry in entries))
    raise ValueError(f"{font}: is not a PSF font")


def _by_words(table: Iterable[int], count: int) -> Iterator[str]:
    """Code points of each glyph up to FFFF."""
    codes = iter(table)
    for _ in range(count):
        of_glyph = list(takewhile(lambda code: code != _END, codes))
        yield from map(chr, takewhile(lambda code: code != _SEQUENCE, of_glyph))
