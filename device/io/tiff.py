"""Reading TIFF files that may be damaged or hostile: declared sizes first, every way to fail, and a silent log."""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO, Final

import numpy as np
import tifffile
from numpy.typing import NDArray

MAX_PIXELS: Final = 1 << 24
"""Pixels of the largest image that is decoded (16.8 million); the largest supported sensor has 12.3 million.

One limit for every file of a bundle: what decodes to more needs more than 1.4 times the memory of an honest scan.
"""

TIFF_READ_ERRORS: Final = (
    OSError,
    ValueError,
    TypeError,
    AttributeError,
    LookupError,
    ArithmeticError,
    AssertionError,
    MemoryError,
    RuntimeError,
    struct.error,
)
"""What tifffile and its codecs raise for bytes that are no TIFF, or a damaged one."""


@contextmanager
def quiet_tiff_log() -> Iterator[None]:
    """Silences tifffile's log: the caller's error says once what is wrong."""
    logger = logging.getLogger("tifffile")
    before = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(before)


def read_page(stream: BinaryIO, dtype: type[np.generic], shape: tuple[int, int] | None = None) -> NDArray[Any]:
    """Return the first page of a TIFF, array (H, W), decoded only when its declared size and type are as expected.

    shape : (H, W) as a record states it; any size within `MAX_PIXELS` when None

    Raises
    ------
    ValueError
        It is no TIFF, damaged, of another type or size, or declares too many pixels.
    """
    try:
        with quiet_tiff_log(), tifffile.TiffFile(stream, name="image") as tiff:
            page = tiff.pages.first
            if len(page.shape) != 2 or page.dtype != dtype or (shape is not None and page.shape != shape):
                raise ValueError(f"its first page is {page.dtype} of shape {page.shape}")
            check_pixel_count(page.shape)
            return np.asarray(page.asarray(maxworkers=1))
    except TIFF_READ_ERRORS as error:
        raise ValueError(f"it cannot be read as a TIFF image: {error}") from error


def check_pixel_count(shape: tuple[int, ...]) -> None:
    """Refuse an image that declares more pixels than are ever decoded.

    Raises
    ------
    ValueError
        Says how many.
    """
    count = 1
    for size in shape:
        count *= size
    if count > MAX_PIXELS:
        raise ValueError(f"it declares {count / 1e6:.0f} million pixels, more than {MAX_PIXELS / 1e6:.0f} million")
