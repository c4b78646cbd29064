"""Opening a TIFF that may be damaged: every way in which that fails, and silence on the log while it does."""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

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
"""What tifffile and its codecs raise for bytes that are no TIFF, or no longer."""


@contextmanager
def quiet_tiff_log() -> Iterator[None]:
    """Keeps tifffile's log quiet: the caller's error says once what is wrong."""
    logger = logging.getLogger("tifffile")
    before = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(before)
