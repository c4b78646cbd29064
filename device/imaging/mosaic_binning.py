"""Raw frames of half the size: pixels of one colour in every 4x4 block are summed, so that a mosaic stays a mosaic."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from hal.frame import RawFrame

MOVIE_BINNING: Final = 2
_BLOCK: Final = 4
_SUMMED: Final = 4
_MAX_COUNT: Final = np.iinfo(np.uint16).max


def can_bin(shape: tuple[int, int]) -> bool:
    """Return whether a frame of `shape` (H, W) consists of 4x4 blocks."""
    return shape[0] % _BLOCK == 0 and shape[1] % _BLOCK == 0


def bin_mosaic(frame: RawFrame) -> RawFrame:
    """Return the frame at half its size: sums of four pixels of one colour, or their mean where sums would not fit 16
    bits.

    Raises
    ------
    ValueError
        The frame does not consist of 4x4 blocks.
    """
    rows, columns = frame.shape
    if not can_bin(frame.shape):
        raise ValueError(f"a mosaic of {columns}x{rows} pixels does not consist of 4x4 blocks")
    blocks = frame.mosaic.astype(np.uint32).reshape(rows // _BLOCK, 2, 2, columns // _BLOCK, 2, 2)
    total = blocks.sum(axis=(1, 4)).reshape(rows // 2, columns // 2)
    scale = _SUMMED if _SUMMED * frame.white_level_dn <= _MAX_COUNT else 1
    counts = total if scale == _SUMMED else (total + _SUMMED // 2) // _SUMMED
    return replace(
        frame,
        mosaic=counts.astype(np.uint16),
        black_level_dn=frame.black_level_dn * scale,
        white_level_dn=frame.white_level_dn * scale,
    )


def unbin_mosaic(frame: RawFrame) -> RawFrame:
    """Return a frame of twice the size in which all four pixels of one colour in a 4x4 block are alike, as `bin_mosaic`
    took them together: a calibration of full-size frames reads it.
    """
    rows, columns = frame.shape
    blocks = frame.mosaic.reshape(rows // 2, 1, 2, columns // 2, 1, 2)
    whole = np.broadcast_to(blocks, (rows // 2, 2, 2, columns // 2, 2, 2))
    return replace(frame, mosaic=np.ascontiguousarray(whole).reshape(2 * rows, 2 * columns))
