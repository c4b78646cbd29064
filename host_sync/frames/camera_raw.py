"""Camera raw files (DNG, NEF, CR2, ARW and others): the Bayer mosaic at its full size, by LibRaw."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import tifffile

from hal.frame import BAYER_ORDERS, BayerOrder, CameraSettings, RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.image_info import Decode, ImageInfo

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
