"""Images of any camera: PNG, TIFF, JPEG and camera raw files, grey or RGB, read completely or refused.

Size and kind come from the header, and completeness from the structure of the file, so a frame set is checked before
minutes of work. Decoders that fill in what a truncated file lacks are not trusted. An image with a reduced copy of
itself, as cameras write it, is read at its full size.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray

from device.io.tiff import TIFF_READ_ERRORS, quiet_tiff_log
from hal.frame import RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.camera_raw import (
    RAW_ERRORS,
    every_page,
    is_page_whole,
    is_raw_file,
    is_raw_tiff,
    raw_shape,
    read_camera_raw,
)

MAX_PIXELS: Final = 100_000_000
"""No gel sensor has more; a header that claims more is a mistake or an attack."""

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
_TIFF: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_DECODE_ERRORS: Final = (*TIFF_READ_ERRORS, *RAW_ERRORS)
_ACCEPTED: Final = "save it as grey or RGB of 8 or 16 bit"

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class ImageInfo:
    """Size and kind of an image, from its header.

    shape : (H, W)
    channels : 1 for grey, 3 for RGB
    bits : per channel as they are stored, 8 or 16
    full_scale : the count at which a pixel is saturated; None where the file does not say
    has_alpha : an opacity is stored beside the colours, which `read_image` drops where every pixel is opaque
    is_raw : a camera's own mosaic of counts
    """

    shape: tuple[int, int]
    channels: int
    bits: int
    full_scale: int | None = None
    has_alpha: bool = False
    is_raw: bool = False


def read_info(path: Path) -> ImageInfo:
    """Size and kind of an image; checks that the file is complete without decoding more pixels than that needs.

    Raises
    ------
    FrameSetError
        Missing, truncated, unreadable, or neither grey nor RGB; names the file.
    """
    info, is_complete, decode = _opened(path)
    if not is_complete:
        raise _damaged(path)
    if info.has_alpha:
        _without_alpha(_decoded(path, decode), path)
    return info


def read_image(path: Path) -> Pixels | RawFrame:
    """The image as stored: array of shape (H, W) or (H, W, 3), R, G, B; or a camera's raw frame.

    Raises
    ------
    FrameSetError
        Missing, truncated, damaged, or neither grey nor RGB; names the file.
    """
    info, is_complete, decode = _opened(path)
    if not is_complete:
        raise _damaged(path)
    decoded = _decoded(path, decode)
    if isinstance(decoded, RawFrame):
        return decoded
    pixels: Pixels = _without_alpha(decoded, path) if info.has_alpha else decoded
    if info.channels == 1 and pixels.ndim == 3:  # a palette of greys
        pixels = pixels[..., 0].copy()
    expected = info.shape if info.channels == 1 else (*info.shape, 3)
    if pixels.shape != expected or pixels.dtype != (np.uint8 if info.bits == 8 else np.uint16):
        raise _damaged(path)
    return pixels


def _damaged(path: Path) -> FrameSetError:
    return FrameSetError(f"{path}: is truncated or damaged: fetch it again")


_Decode = Callable[[], Pixels | RawFrame]


def _opened(path: Path) -> tuple[ImageInfo, bool, _Decode]:
    """The header's facts, whether the file extends to the end that it claims, and what decodes its pixels."""
    try:
        with path.open("rb") as stream:
            start = stream.read(16)
            stream.seek(0)
            if start and _PNG.startswith(start[:8]):
                opened = _open_png(path, stream)
            elif start.startswith(_JPEG):
                opened = _open_jpeg(path, stream.read())
            elif is_raw_file(path, start):
                opened = _open_raw(path)
            elif start[:4] in _TIFF:
                opened = _open_tiff(path)
            else:
                raise FrameSetError(f"{path}: is not a PNG, TIFF, JPEG or camera raw image: save it as one of them")
    except OSError as error:
        raise FrameSetError(f"{path}: cannot be read ({error.strerror}): correct the path or the file") from error
    info = opened[0]
    rows, columns = info.shape
    if min(rows, columns) < 1 or rows * columns > MAX_PIXELS:
        raise FrameSetError(f"{path}: claims {columns}x{rows} pixels, more than any sensor has: name another file")
    if info.channels not in (1, 3) or info.bits not in (8, 16):
        channels = "1 channel" if info.channels == 1 else f"{info.channels} channels"
        raise FrameSetError(f"{path}: has {channels} of {info.bits} bit: {_ACCEPTED}")
    return opened


def _decoded(path: Path, decode: _Decode) -> Any:
    try:
        return decode()
    except FrameSetError:
        raise
    except _DECODE_ERRORS as error:
        raise _damaged(path) from error


def _without_alpha(pixels: NDArray[Any], path: Path) -> Any:
    """Colours alone; refused where a pixel is not opaque: what it shows depends on what lies under it."""
    if not (pixels[..., -1] == np.iinfo(pixels.dtype).max).all():
        raise FrameSetError(f"{path}: has transparent pixels: save it without transparency")
    return np.ascontiguousarray(pixels[..., 0] if pixels.shape[-1] == 2 else pixels[..., :-1])


_MAX_CHUNKS: Final = 100_000
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 3, 4: 1, 6: 3}
_PNG_PALETTE: Final = 3
_PNG_ALPHA: Final = (4, 6)


def _open_png(path: Path, stream: BinaryIO) -> tuple[ImageInfo, bool, _Decode]:
    header = stream.read(29)
    if len(header) < 29 or not header.startswith(_PNG) or header[12:16] != b"IHDR":
        raise _damaged(path)
    columns, rows, bits, colour = struct.unpack(">IIBB", header[16:26])
    info = ImageInfo((rows, columns), _PNG_CHANNELS.get(colour, 0), bits, has_alpha=colour in _PNG_ALPHA)
    is_complete = False
    for kind, at, length in _png_chunks(stream):
        is_complete = is_complete or kind == b"IEND"
        if kind == b"PLTE" and colour == _PNG_PALETTE:
            stream.seek(at)
            info = replace(info, channels=_palette_channels(np.frombuffer(stream.read(length), np.uint8)), bits=8)
        elif kind == b"tRNS":
            info = replace(info, has_alpha=True)
        elif kind == b"sBIT" and bits == 16:
            stream.seek(at)
            info = replace(info, full_scale=(1 << max(stream.read(min(length, 3)), default=16)) - 1)
    return info, is_complete, lambda: imagecodecs.png_decode(path.read_bytes())


def _palette_channels(entries: NDArray[np.uint8]) -> int:
    """1 where a palette holds greys alone, so that the image is one of greys; else 3."""
    colours = entries[: len(entries) // 3 * 3].reshape(-1, 3)
    return 1 if (colours == colours[:, :1]).all() else 3


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


_TIFF_GREY: Final = (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.MINISWHITE)
_TIFF_ALPHA: Final = (tifffile.EXTRASAMPLE.ASSOCALPHA, tifffile.EXTRASAMPLE.UNASSALPHA)
_JPEG_COMPRESSIONS: Final = (tifffile.COMPRESSION.JPEG, tifffile.COMPRESSION.OJPEG)
_MAX_SAMPLE: Final = ("MaxSampleValue", "SMaxSampleValue", "WhiteLevel")


def _open_tiff(path: Path) -> tuple[ImageInfo, bool, _Decode]:
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            size = path.stat().st_size
            if is_raw_tiff(tiff):
                if not all(is_page_whole(page, size) for page in every_page(tiff)):
                    raise _damaged(path)  # LibRaw would say so on the terminal
                return _open_raw(path)
            page = _full_page(tiff, path)
            info, is_complete = _page_info(page, path), is_page_whole(page, size)
    except FrameSetError:
        raise
    except TIFF_READ_ERRORS as error:
        raise _damaged(path) from error
    return info, is_complete, lambda: _page_pixels(path)


def _full_page(tiff: tifffile.TiffFile, path: Path) -> tifffile.TiffPage:
    """The page of the image itself: neither a reduced copy of it nor a mask.

    Raises
    ------
    FrameSetError
        There are several.
    """
    every = every_page(tiff)
    images = [page for page in every if not page.is_reduced and not page.is_mask] or every[:1]
    if len(images) != 1:
        raise FrameSetError(f"{path}: holds {len(images)} pages: save the right one as its own file")
    return images[0]


def _page_info(page: tifffile.TiffPage, path: Path) -> ImageInfo:
    kind, dtype, stored = page.photometric, page.dtype, page.bitspersample
    is_jpeg_colour = kind == tifffile.PHOTOMETRIC.YCBCR and page.compression in _JPEG_COMPRESSIONS
    is_palette = kind == tifffile.PHOTOMETRIC.PALETTE and page.colormap is not None
    if kind not in (*_TIFF_GREY, tifffile.PHOTOMETRIC.RGB) and not is_jpeg_colour and not is_palette:
        raise FrameSetError(f"{path}: is neither grey nor RGB: {_ACCEPTED}")
    samples, alphas = int(page.samplesperpixel), [one for one in page.extrasamples if one in _TIFF_ALPHA]
    if dtype is None or dtype.kind != "u" or page.imagedepth != 1:
        raise FrameSetError(f"{path}: holds {dtype} of shape {page.shape}: {_ACCEPTED}")
    channels, bits = samples - len(alphas), 8 * dtype.itemsize
    if is_palette and samples == 1:
        channels, bits, stored = _palette_channels(_tiff_palette(page)), 8, 8
    full_scale = (1 << stored) - 1 if stored not in (8, 16) else None
    if stored == 16:
        stated = [int(np.max(page.tags[tag].value)) for tag in _MAX_SAMPLE if tag in page.tags]
        full_scale = next((one for one in stated if one > 0), _ome_full_scale(page))
    if stored < 8:
        bits = stored
    return ImageInfo((int(page.imagelength), int(page.imagewidth)), channels, bits, full_scale, bool(alphas))


def _ome_full_scale(page: tifffile.TiffPage) -> int | None:
    """The full scale that microscopes' metadata state as a number of significant bits."""
    _, _, rest = (page.description or "").partition('SignificantBits="')
    bits = rest.partition('"')[0]
    return (1 << int(bits)) - 1 if bits.isdecimal() and 8 < int(bits) <= 16 else None


def _tiff_palette(page: tifffile.TiffPage) -> NDArray[np.uint8]:
    """Entries of the palette, R, G, B of 8 bit one after another; the file stores planes of 16 bit."""
    return np.asarray(np.asarray(page.colormap) >> 8, np.uint8).reshape(3, -1).T.ravel()


def _page_pixels(path: Path) -> Pixels:
    with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
        page = _full_page(tiff, path)
        pixels = np.asarray(page.asarray(maxworkers=1))
        if page.samplesperpixel > 1 and page.planarconfig == tifffile.PLANARCONFIG.SEPARATE:
            pixels = np.ascontiguousarray(np.moveaxis(pixels, 0, -1))
        if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
            pixels = np.asarray((1 << page.bitspersample) - 1 - pixels, pixels.dtype)
        if page.photometric == tifffile.PHOTOMETRIC.PALETTE:
            pixels = _tiff_palette(page).reshape(-1, 3)[pixels]
        return pixels


def _open_raw(path: Path) -> tuple[ImageInfo, bool, _Decode]:
    try:
        shape = raw_shape(path)
    except FrameSetError:
        raise
    except RAW_ERRORS as error:
        raise FrameSetError(f"{path}: is a camera raw file that cannot be read ({error}): save it as TIFF") from error
    return ImageInfo(shape, 3, 16, is_raw=True), True, lambda: read_camera_raw(path)


JPEG_END: Final = b"\xff\xd9"
_WITHOUT_SIZE: Final = (0xC4, 0xC8, 0xCC)
_START_OF_SCAN: Final = 0xDA
_ALONE: Final = (0x01, *range(0xD0, 0xD8))
"""Markers without a length."""

_FILLER: Final = bytes(np.random.default_rng(1).integers(1, 255, 4096, dtype=np.uint8))
"""Entropy-coded noise without a marker: a decoder that still lacks pixels takes them from here."""


def _open_jpeg(path: Path, data: bytes) -> tuple[ImageInfo, bool, _Decode]:
    info = jpeg_info(data)
    if info is None:
        raise _damaged(path)

    def decode() -> Pixels:
        pixels = decode_whole_jpeg(data)
        if pixels is None:
            raise _damaged(path)
        return pixels

    # Some cameras leave the end marker out: then only the pixels show that nothing is missing.
    return info, jpeg_has_end(data) or decode_whole_jpeg(data) is not None, decode


def jpeg_info(data: bytes) -> ImageInfo | None:
    """Size and kind of a JPEG; None when its header holds none."""
    for marker, at, _ in _segments(data):
        if 0xC0 <= marker <= 0xCF and marker not in _WITHOUT_SIZE and at + 10 <= len(data):
            bits, rows, columns, channels = struct.unpack(">BHHB", data[at + 4 : at + 10])
            is_deep = 8 < bits <= 16
            full_scale = (1 << bits) - 1 if is_deep and bits != 16 else None
            return ImageInfo((rows, columns), channels, 16 if is_deep else bits, full_scale)
    return None


def jpeg_has_end(data: bytes) -> bool:
    """Return whether an end marker follows the start of the image data, not only that of an embedded thumbnail."""
    begin = next((end for marker, _, end in _segments(data) if marker == _START_OF_SCAN), len(data))
    return data.rfind(JPEG_END) > begin


def decode_whole_jpeg(data: bytes) -> Pixels | None:
    """Pixels of a JPEG; None when the image data end too early, even if an end marker follows.

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
