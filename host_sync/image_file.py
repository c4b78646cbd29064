"""Images that any camera took: PNG, TIFF and JPEG of 8 or 16 bit, grey or RGB, read whole or refused.

Size and kind come from the header alone, and whether a file ends where it says it does from its skeleton, so that a
frame set is checked before minutes of work. Decoders that fill in what a truncated file lacks are not trusted.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray

from device.tiff_reading import TIFF_READ_ERRORS, quiet_tiff_log
from host_sync.errors import FrameSetError
from host_sync.image_ends import ends_well
from host_sync.jpeg import decode_whole_jpeg, jpeg_size

MOST_PIXELS: Final = 100_000_000
"""No gel sensor has more; a header that claims more is a mistake or an attack."""

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
_TIFF: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_DECODE_ERRORS: Final = (OSError, ValueError, RuntimeError, MemoryError)

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class ImageFacts:
    """What an image's header says.

    shape : (H, W)
    channels : 1 for grey, 3 for RGB
    bits : per channel, 8 or 16
    """

    shape: tuple[int, int]
    channels: int
    bits: int


def read_facts(path: Path) -> ImageFacts:
    """Size and kind of an image, from its header; its pixels are not decoded, but they are all there.

    Raises
    ------
    FrameSetError
        Missing, truncated, no image that can be read, or of a kind that does not carry light; names the file.
    """
    facts = _header_facts(path)
    if not ends_well(path):
        raise FrameSetError(f"{path}: is truncated or damaged: fetch it again")
    return facts


def _header_facts(path: Path) -> ImageFacts:
    try:
        with path.open("rb") as stream:
            start = stream.read(4)
            if _PNG.startswith(start) and start:
                facts = _png_facts(start + stream.read(25), path)
            elif start.startswith(_JPEG):
                facts = _jpeg_facts(start + stream.read(), path)
            elif start in _TIFF:
                facts = _tiff_facts(path)
            else:
                raise FrameSetError(f"{path}: is no PNG, TIFF or JPEG image: save it as one of them")
    except OSError as error:
        raise FrameSetError(f"{path}: cannot be read ({error.strerror}): mend the path or the file") from error
    rows, columns = facts.shape
    if min(rows, columns) < 1 or rows * columns > MOST_PIXELS:
        raise FrameSetError(f"{path}: claims {columns}x{rows} pixels, which no frame has: name another file")
    if facts.channels not in (1, 3) or facts.bits not in (8, 16):
        raise FrameSetError(
            f"{path}: has {facts.channels} channels of {facts.bits} bit: save it as grey or RGB of 8 or 16 bit"
        )
    return facts


def read_pixels(path: Path) -> Pixels:
    """The image as it was stored: array of shape (H, W) or (H, W, 3), R, G, B.

    Raises
    ------
    FrameSetError
        Missing, truncated, damaged, or of a kind that does not carry light; names the file.
    """
    facts = read_facts(path)
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
    expected = facts.shape if facts.channels == 1 else (*facts.shape, 3)
    if pixels is None or pixels.shape != expected or pixels.dtype not in (np.uint8, np.uint16):
        raise damaged
    return pixels


def _png_facts(header: bytes, path: Path) -> ImageFacts:
    if len(header) < 29 or not header.startswith(_PNG) or header[12:16] != b"IHDR":
        raise FrameSetError(f"{path}: is truncated or damaged: fetch it again")
    columns, rows, bits, colour = struct.unpack(">IIBB", header[16:26])
    if colour == 3:
        raise FrameSetError(f"{path}: is a picture with a colour palette: save it as grey or RGB of 8 or 16 bit")
    return ImageFacts((rows, columns), {0: 1, 2: 3, 4: 2, 6: 4}.get(colour, 0), bits)


def _jpeg_facts(data: bytes, path: Path) -> ImageFacts:
    found = jpeg_size(data)
    if found is None:
        raise FrameSetError(f"{path}: is truncated or damaged: fetch it again")
    return ImageFacts(*found)


def _tiff_facts(path: Path) -> ImageFacts:
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            page, pages = tiff.pages.first, len(tiff.pages)
            shape, dtype, photometric = tuple(int(size) for size in page.shape), page.dtype, page.photometric
    except TIFF_READ_ERRORS as error:
        raise FrameSetError(f"{path}: is truncated or damaged: fetch it again") from error
    if pages != 1:
        raise FrameSetError(f"{path}: holds {pages} pages: save the one that is meant as its own file")
    if photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB) or dtype is None:
        raise FrameSetError(f"{path}: is neither grey nor RGB: save it as grey or RGB of 8 or 16 bit")
    if len(shape) not in (2, 3) or dtype.kind != "u":
        raise FrameSetError(f"{path}: holds {dtype} of shape {shape}: save it as grey or RGB of 8 or 16 bit")
    return ImageFacts((shape[0], shape[1]), 1 if len(shape) == 2 else shape[2], 8 * dtype.itemsize)


def _tiff_pixels(path: Path) -> Pixels | None:
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            return np.asarray(tiff.pages.first.asarray(maxworkers=1))
    except TIFF_READ_ERRORS:
        return None
