"""TIFF files, and camera raw files (DNG, NEF, CR2, ARW and others), which LibRaw reads as mosaics of full size.

A TIFF holds its image among reduced copies, or three lights in pages; its tags state which.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import tifffile
from numpy.typing import NDArray

from device.io.tiff import TIFF_READ_ERRORS, quiet_tiff_log
from hal.frame import BAYER_ORDERS, BayerOrder, CameraSettings, RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.image_info import (
    ACCEPTED,
    ORIENTATION_TAG,
    Decode,
    ImageInfo,
    Pixels,
    damaged,
    known_orientation,
    palette_channels,
)

if TYPE_CHECKING:
    import rawpy

RAW_SUFFIXES: Final = frozenset(
    f".{name}"
    for name in (
        *("3fr", "arw", "cr2", "cr3", "crw", "dcr", "dng", "erf", "fff", "iiq", "kdc", "mef", "mos", "mrw", "nef"),
        *("nrw", "orf", "pef", "raf", "raw", "rw2", "rwl", "sr2", "srf", "srw", "x3f"),
    )
)
_RAW_STARTS: Final = (b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FUJIFILMCCD-RAW", b"FOVb", b"\0MRM")
_CFA: Final = (tifffile.PHOTOMETRIC.CFA, tifffile.PHOTOMETRIC.LINEAR_RAW)
_DNG_VERSION: Final = 50706

RAW_ERRORS: Final = (ValueError, RuntimeError, OSError)
"""Errors that `read_camera_raw` raises for a damaged file, besides FrameSetError."""

_ORIENTATIONS: Final = {3: 3, 5: 8, 6: 6}
"""As EXIF numbers what LibRaw calls flips."""


def is_raw_file(path: Path, start: bytes) -> bool:
    """Return whether a file is a camera raw one by its first bytes, or by its suffix where those say nothing."""
    is_tiff = start[:4] in (b"II*\0", b"MM\0*")
    if start.startswith(_RAW_STARTS) or start[4:12] == b"ftypcrx " or (is_tiff and start[8:10] == b"CR"):
        return True
    return not is_tiff and path.suffix.lower() in RAW_SUFFIXES and bool(start)


def is_raw_tiff(tiff: tifffile.TiffFile) -> bool:
    """Return whether a TIFF is a camera raw file: it holds a mosaic, in whichever page, or says that it is a DNG."""
    pages = every_page(tiff)
    return any(page.photometric in _CFA for page in pages) or _DNG_VERSION in pages[0].tags


def every_page(tiff: tifffile.TiffFile) -> list[tifffile.TiffPage]:
    """Return the pages of a TIFF, and after them those inside of pages.

    Raises
    ------
    ValueError
        A page leads back to an earlier one.
    """
    pages: dict[int, tifffile.TiffPage] = {}
    for page in tiff.pages:
        if page.offset in pages:
            raise ValueError(f"page {len(pages)} leads back to an earlier one")
        pages[page.offset] = page.aspage()
    return [*pages.values(), *(inner.aspage() for page in pages.values() for inner in page.pages or ())]


def is_page_whole(page: tifffile.TiffPage, size: int) -> bool:
    """Return whether every strip or tile of a page lies inside a file of that size."""
    spans = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    return bool(spans) and all(offset > 0 and offset + count <= size for offset, count in spans)


def open_raw(path: Path) -> tuple[ImageInfo, bool, Decode]:
    """Return the header's facts, whether the file is complete, and what decodes its pixels.

    Raises
    ------
    FrameSetError
        It is damaged, or holds no mosaic of a Bayer sensor.
    """
    try:
        with _opened(path) as raw:
            _bayer_order(raw, path)
            sizes = raw.sizes
            shape, flip = (sizes.height // 2 * 2, sizes.width // 2 * 2), sizes.flip
    except FrameSetError:
        raise
    except RAW_ERRORS as error:
        raise FrameSetError(f"{path}: is a camera raw file that cannot be read ({error}): save it as TIFF") from error
    info = ImageInfo(shape, 3, 16, is_raw=True, orientation=_ORIENTATIONS.get(flip, 1))
    return info, True, lambda: read_camera_raw(path)


def read_camera_raw(path: Path) -> RawFrame:
    """Return the mosaic with its black and white levels; FrameSetError where it has none, else one of `RAW_ERRORS`."""
    with _opened(path) as raw:
        order = _bayer_order(raw, path)
        visible = raw.raw_image_visible
        rows, columns = (size // 2 * 2 for size in visible.shape)
        mosaic = np.array(visible[:rows, :columns], np.uint16)
        colours = raw.raw_colors_visible
        blacks = [raw.black_level_per_channel[int(colours[row, column])] for row in (0, 1) for column in (0, 1)]
        least = min(blacks)
        for site, black in enumerate(blacks):
            if black > least:
                plane = mosaic[site // 2 :: 2, site % 2 :: 2]
                plane -= np.minimum(plane, np.uint16(black - least))
        white = raw.white_level
    if not white or not white > least:
        raise FrameSetError(f"{path}: is a camera raw file without a white level: save it as TIFF of 16 bit")
    unknown = CameraSettings(math.nan, math.nan)
    return RawFrame(mosaic, order, float(least), float(white), unknown, 0)


@contextmanager
def _opened(path: Path) -> Iterator[rawpy.RawPy]:
    import rawpy  # here, because it takes a while to load

    try:
        with rawpy.imread(str(path)) as raw:
            yield raw
    except rawpy.LibRawError as error:
        words = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise ValueError(words) from error


def _bayer_order(raw: rawpy.RawPy, path: Path) -> BayerOrder:
    import rawpy

    unread = FrameSetError(
        f"{path}: is a camera raw file, but not of a Bayer sensor: convert it to a TIFF of 16 bit with linear values"
    )
    if raw.raw_type != rawpy.RawType.Flat or raw.raw_pattern is None or raw.raw_pattern.shape != (2, 2):
        raise unread
    names = raw.color_desc.decode()
    colours = raw.raw_colors_visible
    order = "".join(names[int(colours[row, column])] for row in (0, 1) for column in (0, 1))
    if order not in BAYER_ORDERS:
        raise unread
    return order


PLANES: Final = 3
"""So many grey pages are the lights of one image, as three grey files are."""

_PAGE_NAME: Final = 285
_NO_LIGHTS: Final = {"T": "frames of a sequence", "Z": "slices of a stack"}

_TIFF_GREY: Final = (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.MINISWHITE)
_TIFF_ALPHA: Final = (tifffile.EXTRASAMPLE.ASSOCALPHA, tifffile.EXTRASAMPLE.UNASSALPHA)
_JPEG_COMPRESSIONS: Final = (tifffile.COMPRESSION.JPEG, tifffile.COMPRESSION.OJPEG)
_MAX_SAMPLE: Final = ("MaxSampleValue", "SMaxSampleValue", "WhiteLevel")


def open_tiff(path: Path) -> tuple[ImageInfo, bool, Decode]:
    """Return the header's facts, whether the file is complete, and what decodes its pixels.

    Raises
    ------
    FrameSetError
        It is damaged, or does not hold one image of grey or RGB.
    """
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            size = path.stat().st_size
            if is_raw_tiff(tiff):
                if not all(is_page_whole(page, size) for page in every_page(tiff)):
                    raise damaged(path)  # LibRaw would say so on the terminal
                return open_raw(path)
            if promises_another_page(tiff):
                raise damaged(path)
            pages = _full_pages(tiff, path)
            is_complete = all(is_page_whole(page, size) for page in pages)
            info = _page_info(pages[0], path)
            info = replace(info, channels=len(pages)) if len(pages) > 1 else info
    except FrameSetError:
        raise
    except TIFF_READ_ERRORS as error:
        raise damaged(path) from error
    return info, is_complete, lambda: _page_pixels(path)


def promises_another_page(tiff: tifffile.TiffFile) -> bool:
    """Return whether the last page found refers to a next one that does not exist."""
    at = tiff.pages.next_page_offset
    if at is None:
        return True
    tiff.filehandle.seek(at)
    stored = tiff.filehandle.read(tiff.tiff.offsetsize)
    return any(stored) or len(stored) < tiff.tiff.offsetsize


def _full_pages(tiff: tifffile.TiffFile, path: Path) -> list[tifffile.TiffPage]:
    """Return the page of the image itself, or those of R, G and B, one grey each.

    Neither a reduced copy nor a mask is one of them.

    Raises
    ------
    FrameSetError
        The file holds other pages.
    """
    every = every_page(tiff)
    images = [page for page in every if not page.is_reduced and not page.is_mask] or every[:1]
    if len(images) == 1:
        return images
    named = {str(page.tags.valueof(_PAGE_NAME, "")).strip().lower()[:1]: page for page in images}
    axis = tiff.series[0].axes[:1] if tiff.is_imagej or tiff.is_ome else ""
    mend = "save the right one as its own file"
    if len(images) != PLANES or axis in _NO_LIGHTS:
        called = f", {_NO_LIGHTS[axis]}" if axis in _NO_LIGHTS else ""
        raise FrameSetError(f"{path}: holds {len(images)} pages{called}: {mend}")
    first = _kind(images[0])
    if first[0] not in _TIFF_GREY or any(page.samplesperpixel != 1 or _kind(page) != first for page in images):
        raise FrameSetError(f"{path}: holds 3 pages that are not grey ones of one size and kind, R, G and B: {mend}")
    return [named[light] for light in "rgb"] if set(named) == set("rgb") else images


def _kind(page: tifffile.TiffPage) -> tuple[object, ...]:
    return page.photometric, page.shape, page.dtype, page.bitspersample, page.tags.valueof(ORIENTATION_TAG, 1)


def _page_info(page: tifffile.TiffPage, path: Path) -> ImageInfo:
    kind, dtype, stored = page.photometric, page.dtype, page.bitspersample
    is_jpeg_colour = kind == tifffile.PHOTOMETRIC.YCBCR and page.compression in _JPEG_COMPRESSIONS
    is_palette = kind == tifffile.PHOTOMETRIC.PALETTE and page.colormap is not None
    if kind not in (*_TIFF_GREY, tifffile.PHOTOMETRIC.RGB) and not is_jpeg_colour and not is_palette:
        raise FrameSetError(f"{path}: is neither grey nor RGB: {ACCEPTED}")
    samples, alphas = int(page.samplesperpixel), [one for one in page.extrasamples if one in _TIFF_ALPHA]
    if dtype is None or dtype.kind != "u" or page.imagedepth != 1:
        raise FrameSetError(f"{path}: holds {dtype} of shape {page.shape}: {ACCEPTED}")
    channels, bits = samples - len(alphas), 8 * dtype.itemsize
    if is_palette and samples == 1:
        channels, bits, stored = palette_channels(_tiff_palette(page)), 8, 8
    full_scale = (1 << stored) - 1 if stored not in (8, 16) else None
    if stored == 16:
        stated = [int(np.max(page.tags[tag].value)) for tag in _MAX_SAMPLE if tag in page.tags]
        full_scale = next((one for one in stated if one > 0), _ome_full_scale(page))
    if stored < 8:
        bits = stored
    shape, orientation = (
        (int(page.imagelength), int(page.imagewidth)),
        known_orientation(page.tags.valueof(ORIENTATION_TAG)),
    )
    return ImageInfo(shape, channels, bits, full_scale, bool(alphas), orientation=orientation)


def _ome_full_scale(page: tifffile.TiffPage) -> int | None:
    """Return the full scale that microscopes' metadata state as a number of significant bits."""
    _, _, rest = (page.description or "").partition('SignificantBits="')
    bits = rest.partition('"')[0]
    return (1 << int(bits)) - 1 if bits.isdecimal() and 8 < int(bits) <= 16 else None


def _tiff_palette(page: tifffile.TiffPage) -> NDArray[np.uint8]:
    """Return entries of the palette, R, G, B of 8 bit one after another; the file stores planes of 16 bit."""
    return np.asarray(np.asarray(page.colormap) >> 8, np.uint8).reshape(3, -1).T.ravel()


def _page_pixels(path: Path) -> Pixels:
    with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
        planes: list[Any] = [_pixels_of(page) for page in _full_pages(tiff, path)]
        return planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)


def _pixels_of(page: tifffile.TiffPage) -> Pixels:
    pixels = np.asarray(page.asarray(maxworkers=1))
    if page.samplesperpixel > 1 and page.planarconfig == tifffile.PLANARCONFIG.SEPARATE:
        pixels = np.ascontiguousarray(np.moveaxis(pixels, 0, -1))
    if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
        pixels = np.asarray((1 << page.bitspersample) - 1 - pixels, pixels.dtype)
    if page.photometric == tifffile.PHOTOMETRIC.PALETTE:
        pixels = _tiff_palette(page).reshape(-1, 3)[pixels]
    return pixels
