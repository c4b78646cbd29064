"""Images of any camera: PNG, TIFF, JPEG and camera raw files, grey or RGB, read completely or refused.

Size and kind come from the header, and completeness from the structure of the file, so a frame set is checked before
minutes of work. Decoders that fill in what a truncated file lacks are not trusted. An image with a reduced copy of
itself, as cameras write it, is read at its full size.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from device.io.tiff import TIFF_READ_ERRORS
from hal.frame import RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.image_info import (
    ACCEPTED,
    EXIF_START,
    Decode,
    ImageInfo,
    Pixels,
    damaged,
    exif_orientation,
    palette_channels,
    shape_upright,
    upright,
)
from host_sync.frames.tiff_file import RAW_ERRORS, is_raw_file, open_raw, open_tiff

MAX_PIXELS: Final = 100_000_000
"""No gel sensor has more; a header that claims more is a mistake or an attack."""

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
_TIFF: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_DECODE_ERRORS: Final = (*TIFF_READ_ERRORS, *RAW_ERRORS)


def read_info(path: Path) -> ImageInfo:
    """Return the size and kind of an image, and check that the file is complete.

    No more pixels are decoded than that needs.

    Raises
    ------
    FrameSetError
        Missing, truncated, unreadable, or neither grey nor RGB; names the file.
    """
    info, is_complete, decode = _opened(path)
    if not is_complete:
        raise damaged(path)
    if info.has_alpha:
        _without_alpha(_decoded(path, decode), path)
    return replace(info, shape=shape_upright(info.shape, info.orientation))


def read_image(path: Path) -> Pixels | RawFrame:
    """Return the image as it is seen: array of shape (H, W) or (H, W, 3), R, G, B; or a camera's raw frame.

    Raises
    ------
    FrameSetError
        Missing, truncated, damaged, or neither grey nor RGB; names the file.
    """
    return read_with_info(path)[1]


def read_with_info(path: Path) -> tuple[ImageInfo, Pixels | RawFrame]:
    """Return the size and kind of an image, and the image; errors as for `read_image`."""
    info, is_complete, decode = _opened(path)
    if not is_complete:
        raise damaged(path)
    decoded = _decoded(path, decode)
    seen = replace(info, shape=shape_upright(info.shape, info.orientation))
    if isinstance(decoded, RawFrame):
        return seen, upright(decoded, info.orientation)
    pixels: Pixels = _without_alpha(decoded, path) if info.has_alpha else decoded
    if info.channels == 1 and pixels.ndim == 3:  # a palette of greys
        pixels = pixels[..., 0].copy()
    expected = info.shape if info.channels == 1 else (*info.shape, 3)
    if pixels.shape != expected or pixels.dtype != (np.uint8 if info.bits == 8 else np.uint16):
        raise damaged(path)
    return seen, upright(pixels, info.orientation)


def _opened(path: Path) -> tuple[ImageInfo, bool, Decode]:
    """Return the header's facts, whether the file extends to the end that it claims, and what decodes its pixels."""
    try:
        with path.open("rb") as stream:
            start = stream.read(16)
            stream.seek(0)
            if start.startswith(_PNG[:4]) or (start and _PNG.startswith(start)):
                opened = _open_png(path, stream)
            elif start.startswith(_JPEG):
                opened = _open_jpeg(path, stream.read())
            elif is_raw_file(path, start):
                opened = open_raw(path)
            elif start[:4] in _TIFF:
                opened = open_tiff(path)
            elif start.strip().isascii() and b"\0" not in start:
                what = "holds text, such as a web page or a pointer of Git LFS" if start.strip() else "is empty"
                raise FrameSetError(f"{path}: {what}: fetch the image itself")
            else:
                raise FrameSetError(f"{path}: is not a PNG, TIFF, JPEG or camera raw image: save it as one of them")
    except OSError as error:
        raise FrameSetError(f"{path}: cannot be read ({error.strerror}): correct the path or the file") from error
    info = opened[0]
    rows, columns = info.shape
    if min(rows, columns) < 1:
        raise FrameSetError(f"{path}: claims {columns}x{rows} pixels: name another file")
    if rows * columns > MAX_PIXELS:
        raise FrameSetError(f"{path}: claims {columns}x{rows} pixels, more than any sensor has: name another file")
    if info.channels not in (1, 3) or info.bits not in (8, 16):
        channels = "1 channel" if info.channels == 1 else f"{info.channels} channels"
        raise FrameSetError(f"{path}: has {channels} of {info.bits} bit: {ACCEPTED}")
    return opened


def _decoded(path: Path, decode: Decode) -> Any:
    try:
        return decode()
    except FrameSetError:
        raise
    except _DECODE_ERRORS as error:
        raise damaged(path) from error


def _without_alpha(pixels: NDArray[Any], path: Path) -> Any:
    """Return colours alone; refused where a pixel is not opaque: what it shows depends on what lies under it."""
    if not (pixels[..., -1] == np.iinfo(pixels.dtype).max).all():
        raise FrameSetError(f"{path}: has transparent pixels: save it without transparency")
    return np.ascontiguousarray(pixels[..., 0] if pixels.shape[-1] == 2 else pixels[..., :-1])


_MAX_CHUNKS: Final = 100_000
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 3, 4: 1, 6: 3}
_PNG_PALETTE: Final = 3
_PNG_ALPHA: Final = (4, 6)


def _open_png(path: Path, stream: BinaryIO) -> tuple[ImageInfo, bool, Decode]:
    header = stream.read(29)
    if len(header) < 29 or not header.startswith(_PNG) or header[12:16] != b"IHDR":
        raise damaged(path)
    columns, rows, bits, colour = struct.unpack(">IIBB", header[16:26])
    info = ImageInfo((rows, columns), _PNG_CHANNELS.get(colour, 0), bits, has_alpha=colour in _PNG_ALPHA)
    is_complete = False
    for kind, at, length in _png_chunks(stream):
        is_complete = is_complete or kind == b"IEND"
        if kind == b"PLTE" and colour == _PNG_PALETTE:
            stream.seek(at)
            info = replace(info, channels=palette_channels(np.frombuffer(stream.read(length), np.uint8)), bits=8)
        elif kind == b"eXIf":
            stream.seek(at)
            info = replace(info, orientation=exif_orientation(stream.read(length)))
        elif kind == b"acTL":
            raise FrameSetError(f"{path}: holds the frames of an animation: save the right one as its own file")
        elif kind == b"tRNS":
            info = replace(info, has_alpha=True)
        elif kind == b"sBIT" and bits == 16:
            stream.seek(at)
            info = replace(info, full_scale=(1 << max(stream.read(min(length, 3)), default=16)) - 1)
    return info, is_complete, lambda: imagecodecs.png_decode(path.read_bytes())


def _png_chunks(stream: BinaryIO) -> Iterator[tuple[bytes, int, int]]:
    """Kind, place of the data and length of each chunk that lies inside the file, up to the last."""
    size = stream.seek(0, 2)
    at = len(_PNG)
    for _ in range(_MAX_CHUNKS):
        stream.seek(at)
        head = stream.read(8)
        if len(head) < 8:
            return
        length, kind = struct.unpack(">I4s", head)
        if at + 12 + length > size:
            return
        yield kind, at + 8, length
        if kind == b"IEND":
            return
        at += 12 + length


JPEG_END: Final = b"\xff\xd9"
_WITHOUT_SIZE: Final = (0xC4, 0xC8, 0xCC)
_START_OF_SCAN: Final = 0xDA
_JPEG_LS: Final = 0xF7
_APP1: Final = 0xE1
_ALONE: Final = (0x01, *range(0xD0, 0xD8))
"""Markers without a length."""

_FILLER: Final = bytes(np.random.default_rng(1).integers(1, 255, 4096, dtype=np.uint8))
"""Entropy-coded noise without a marker: a decoder that still lacks pixels takes them from here."""


def _open_jpeg(path: Path, data: bytes) -> tuple[ImageInfo, bool, Decode]:
    info = jpeg_info(data)
    if info is None:
        if any(marker == _JPEG_LS for marker, _, _ in _segments(data)):
            raise FrameSetError(f"{path}: is a JPEG-LS image, not a JPEG: save it as PNG")
        raise damaged(path)

    def decode() -> Pixels:
        pixels = decode_whole_jpeg(data)
        if pixels is None:
            raise damaged(path)
        return pixels

    # Some cameras leave the end marker out: then only the pixels show that nothing is missing.
    return info, jpeg_has_end(data) or decode_whole_jpeg(data) is not None, decode


def jpeg_info(data: bytes) -> ImageInfo | None:
    """Return the size and kind of a JPEG; None when its header holds none."""
    orientation = 1
    for marker, at, end in _segments(data):
        if marker == _APP1 and data.startswith(EXIF_START, at + 4):
            orientation = exif_orientation(data[at + 4 + len(EXIF_START) : end])
        if 0xC0 <= marker <= 0xCF and marker not in _WITHOUT_SIZE and at + 10 <= len(data):
            bits, rows, columns, channels = struct.unpack(">BHHB", data[at + 4 : at + 10])
            is_deep = 8 < bits <= 16
            full_scale = (1 << bits) - 1 if is_deep and bits != 16 else None
            return ImageInfo((rows, columns), channels, 16 if is_deep else bits, full_scale, orientation=orientation)
    return None


def jpeg_has_end(data: bytes) -> bool:
    """Return whether an end marker follows the start of the image data, not only that of an embedded thumbnail."""
    begin = next((end for marker, _, end in _segments(data) if marker == _START_OF_SCAN), len(data))
    return data.rfind(JPEG_END) > begin


def decode_whole_jpeg(data: bytes) -> Pixels | None:
    """Return pixels of a JPEG; None when the image data end too early, even if an end marker follows.

    Decoders fill in missing pixels without an error. The file is therefore decoded again with noise before its end
    marker: a complete image does not change, a truncated one does.
    """
    end = data.rfind(JPEG_END) if jpeg_has_end(data) else len(data)
    try:
        pixels = np.asarray(imagecodecs.jpeg8_decode(data[:end] + JPEG_END))
        longer = np.asarray(imagecodecs.jpeg8_decode(data[:end] + _FILLER + JPEG_END))
    except _DECODE_ERRORS:
        return None
    return pixels if np.array_equal(pixels, longer) else None


def _segments(data: bytes) -> list[tuple[int, int, int]]:
    """Marker, begin and end of each segment up to the first scan."""
    segments, at = [], 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF or marker in _ALONE:  # a fill byte, or a marker without data
            at += 1 if marker == 0xFF else 2
            continue
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        segments.append((marker, at, at + 2 + length))
        if marker == _START_OF_SCAN:
            break
        at += 2 + max(length, 2)
    return segments
