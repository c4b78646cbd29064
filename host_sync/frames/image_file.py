"""Images of any camera: PNG, TIFF and JPEG of 8 or 16 bit, grey or RGB, read completely or refused.

Size and kind come from the header, and completeness from the structure of the file, so a frame set is checked before
minutes of work. Decoders that fill in what a truncated file lacks are not trusted.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray

from device.io.tiff import TIFF_READ_ERRORS, quiet_tiff_log
from host_sync.errors import FrameSetError

MAX_PIXELS: Final = 100_000_000
"""No gel sensor has more; a header that claims more is a mistake or an attack."""

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
_TIFF: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_DECODE_ERRORS: Final = (OSError, ValueError, RuntimeError, MemoryError)

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class ImageInfo:
    """What an image's header says.

    shape : (H, W)
    channels : 1 for grey, 3 for RGB
    bits : per channel, 8 or 16
    """

    shape: tuple[int, int]
    channels: int
    bits: int


def read_info(path: Path) -> ImageInfo:
    """Size and kind of an image, from its header; checks that the file is complete without decoding pixels.

    Raises
    ------
    FrameSetError
        Missing, truncated, unreadable, or neither grey nor RGB; names the file.
    """
    info = _header_info(path)
    if not is_complete(path):
        raise FrameSetError(f"{path}: is truncated or damaged: fetch it again")
    return info


def _header_info(path: Path) -> ImageInfo:
    try:
        with path.open("rb") as stream:
            start = stream.read(4)
            if _PNG.startswith(start) and start:
                info = _png_info(start + stream.read(25), path)
            elif start.startswith(_JPEG):
                info = _jpeg_info(start + stream.read(), path)
            elif start in _TIFF:
                info = _tiff_info(path)
            else:
                raise FrameSetError(f"{path}: is not a PNG, TIFF or JPEG image: save it as one of them")
    except OSError as error:
        raise FrameSetError(f"{path}: cannot be read ({error.strerror}): correct the path or the file") from error
    rows, columns = info.shape
    if min(rows, columns) < 1 or rows * columns > MAX_PIXELS:
        raise FrameSetError(f"{path}: claims {columns}x{rows} pixels, more than any sensor has: name another file")
    if info.channels not in (1, 3) or info.bits not in (8, 16):
        raise FrameSetError(
            f"{path}: has {info.channels} channels of {info.bits} bit: save it as grey or RGB of 8 or 16 bit"
        )
    return info


def read_pixels(path: Path) -> Pixels:
    """The image as stored: array of shape (H, W) or (H, W, 3), R, G, B.

    Raises
    ------
    FrameSetError
        Missing, truncated, damaged, or neither grey nor RGB; names the file.
    """
    info = read_info(path)
    damaged = FrameSetError(f"{path}: is truncated or damaged: fetch it again")
    pixels: Pixels | None
    try:
        data = path.read_bytes()
        if data.startswith(_PNG):
            pixels = imagecodecs.png_decode(data)
        elif data.startswith(_JPEG):
            pixels = decode_whole_jpeg(data)
        else:
            pixels = _tiff_pixels(path)
    except _DECODE_ERRORS as error:
        raise damaged from error
    expected = info.shape if info.channels == 1 else (*info.shape, 3)
    if pixels is None or pixels.shape != expected or pixels.dtype not in (np.uint8, np.uint16):
        raise damaged
    return pixels


def _png_info(header: bytes, path: Path) -> ImageInfo:
    if len(header) < 29 or not header.startswith(_PNG) or header[12:16] != b"IHDR":
        raise FrameSetError(f"{path}: is truncated or damaged: fetch it again")
    columns, rows, bits, colour = struct.unpack(">IIBB", header[16:26])
    if colour == 3:
        raise FrameSetError(f"{path}: has a colour palette: save it as grey or RGB of 8 or 16 bit")
    return ImageInfo((rows, columns), {0: 1, 2: 3, 4: 2, 6: 4}.get(colour, 0), bits)


def _jpeg_info(data: bytes, path: Path) -> ImageInfo:
    found = jpeg_size(data)
    if found is None:
        raise FrameSetError(f"{path}: is truncated or damaged: fetch it again")
    return ImageInfo(*found)


def _tiff_info(path: Path) -> ImageInfo:
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            page, pages = tiff.pages.first, len(tiff.pages)
            shape, dtype, photometric = tuple(int(size) for size in page.shape), page.dtype, page.photometric
    except TIFF_READ_ERRORS as error:
        raise FrameSetError(f"{path}: is truncated or damaged: fetch it again") from error
    if pages != 1:
        raise FrameSetError(f"{path}: holds {pages} pages: save the right one as its own file")
    if photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB) or dtype is None:
        raise FrameSetError(f"{path}: is neither grey nor RGB: save it as grey or RGB of 8 or 16 bit")
    if len(shape) not in (2, 3) or dtype.kind != "u":
        raise FrameSetError(f"{path}: holds {dtype} of shape {shape}: save it as grey or RGB of 8 or 16 bit")
    return ImageInfo((shape[0], shape[1]), 1 if len(shape) == 2 else shape[2], 8 * dtype.itemsize)


def _tiff_pixels(path: Path) -> Pixels | None:
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            return np.asarray(tiff.pages.first.asarray(maxworkers=1))
    except TIFF_READ_ERRORS:
        return None


_MAX_CHUNKS: Final = 100_000


def is_complete(path: Path) -> bool:
    """Whether a PNG, JPEG or TIFF extends to the end that it claims."""
    with path.open("rb") as stream:
        start = stream.read(len(_PNG))
        if start == _PNG:
            return _png_is_complete(stream)
        if start.startswith(_JPEG):
            return jpeg_has_end(start + stream.read())
    return _tiff_is_complete(path)


def _png_is_complete(stream: BinaryIO) -> bool:
    """Whether all chunks have their stated length, up to the last."""
    size = stream.seek(0, 2)
    at = len(_PNG)
    for _ in range(_MAX_CHUNKS):
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


def _tiff_is_complete(path: Path) -> bool:
    """Whether every strip or tile of the first page lies inside the file."""
    size = path.stat().st_size
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            page = tiff.pages.first
            spans = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    except TIFF_READ_ERRORS:
        return False
    return bool(spans) and all(offset > 0 and offset + count <= size for offset, count in spans)


JPEG_END: Final = b"\xff\xd9"
_WITHOUT_SIZE: Final = (0xC4, 0xC8, 0xCC)
_START_OF_SCAN: Final = 0xDA
_FILLER: Final = bytes(np.random.default_rng(1).integers(1, 255, 4096, dtype=np.uint8))
"""Entropy-coded noise without a marker: a decoder that still lacks pixels takes them from here."""


def jpeg_size(data: bytes) -> tuple[tuple[int, int], int, int] | None:
    """Shape (H, W), channels and bits of a JPEG; None when its header holds none."""
    for marker, at, _ in _segments(data):
        if 0xC0 <= marker <= 0xCF and marker not in _WITHOUT_SIZE and at + 10 <= len(data):
            bits, rows, columns, channels = struct.unpack(">BHHB", data[at + 4 : at + 10])
            return (rows, columns), channels, bits
    return None


def jpeg_has_end(data: bytes) -> bool:
    """Whether an end marker follows the start of the image data, not only that of an embedded thumbnail."""
    begin = next((end for marker, _, end in _segments(data) if marker == _START_OF_SCAN), len(data))
    return data.rfind(JPEG_END) > begin


def decode_whole_jpeg(data: bytes) -> NDArray[np.uint8] | None:
    """Pixels of a JPEG; None when the image data end too early, even if an end marker follows.

    Decoders fill in missing pixels without an error. The file is therefore decoded again with noise before its end
    marker: a complete image does not change, a truncated one does.
    """
    end = data.rfind(JPEG_END)
    if not jpeg_has_end(data):
        return None
    pixels = np.asarray(imagecodecs.jpeg8_decode(data))
    longer = np.asarray(imagecodecs.jpeg8_decode(data[:end] + _FILLER + JPEG_END))
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
