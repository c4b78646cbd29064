"""JPEG frames: their size from the header, and their pixels only when none of them was made up by the decoder."""

from __future__ import annotations

import struct
from typing import Final

import imagecodecs
import numpy as np
from numpy.typing import NDArray

END: Final = b"\xff\xd9"
_WITHOUT_SIZE: Final = (0xC4, 0xC8, 0xCC)
_START_OF_SCAN: Final = 0xDA
_MORE: Final = bytes(np.random.default_rng(1).integers(1, 255, 4096, dtype=np.uint8))
"""Entropy-coded nonsense without a marker: a decoder that still lacks pixels takes them from here."""


def jpeg_size(data: bytes) -> tuple[tuple[int, int], int, int] | None:
    """Shape (H, W), channels and bits of a JPEG; None when its header holds none."""
    for marker, at, _ in _segments(data):
        if 0xC0 <= marker <= 0xCF and marker not in _WITHOUT_SIZE and at + 10 <= len(data):
            bits, rows, columns, channels = struct.unpack(">BHHB", data[at + 4 : at + 10])
            return (rows, columns), channels, bits
    return None


def has_end(data: bytes) -> bool:
    """Whether an end mark stands behind the beginning of the image data, and not just in an embedded thumbnail."""
    begin = next((end for marker, _, end in _segments(data) if marker == _START_OF_SCAN), len(data))
    return data.rfind(END) > begin


def decode_whole_jpeg(data: bytes) -> NDArray[np.uint8] | None:
    """The pixels; None when the image data end before the last of them, whatever the end mark says.

    A decoder fills what is missing without a word. So the file is decoded once more with nonsense before its end mark:
    a whole image has no use for it, one that was cut short shows it.
    """
    end = data.rfind(END)
    if not has_end(data):
        return None
    pixels = np.asarray(imagecodecs.jpeg8_decode(data))
    longer = np.asarray(imagecodecs.jpeg8_decode(data[:end] + _MORE + END))
    return pixels if np.array_equal(pixels, longer) else None


def _segments(data: bytes) -> list[tuple[int, int, int]]:
    """Marker, begin and end of each segment up to the first scan."""
    segments, at = [], 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        segments.append((marker, at, at + 2 + length))
        if marker == _START_OF_SCAN:
            break
        at += 2 + max(length, 2)
    return segments
