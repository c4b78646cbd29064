"""From stored counts to intensity in one pass over memory: black level, demosaicing, division by the reference.

The same arithmetic as `device.photometry.demosaic` and `divide`, bit for bit, without the full-size frames between
them; tests hold the two side by side. Each band of rows is worked off by one thread, so that the result does not depend
on how many there are.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit, prange

from device.photometry import DARK_FLOOR, SATURATED, IntensityImage, check_same_size, demosaic, divide
from device.surface import Float32Array
from hal.frame import RawFrame
from host_sync.image_file import Pixels

_BAND_ROWS: Final = 32
_LEAST_SIDE: Final = 4
"""Smaller mosaics have no pixel with all its neighbours; the portable path takes them."""


def empty_intensity(shape: tuple[int, int]) -> IntensityImage:
    """An image of shape (H, W) for the functions below to fill, again and again; its pixels mean nothing yet."""
    return IntensityImage(np.empty((*shape, 3), np.float32), np.empty(shape, np.bool_), np.empty(shape, np.bool_))


def raw_intensity(frame: RawFrame, divisor: Float32Array, out: IntensityImage | None = None) -> IntensityImage:
    """Intensity of a raw frame, `divide(demosaic(frame), divisor)`, in `out` when it is given.

    divisor : float32 array of shape (H, W, 3), `blurred_reference` or `pseudo_reference`

    Raises
    ------
    CalibrationMismatch
        The frame's size differs from the reference's.
    """
    check_same_size(frame.shape, divisor)
    if min(frame.shape) < _LEAST_SIDE:
        return divide(demosaic(frame), divisor)
    image = out or empty_intensity(frame.shape)
    scale = np.float32(1.0 / (frame.white_level_dn - frame.black_level_dn))
    limit = frame.black_level_dn + SATURATED * (frame.white_level_dn - frame.black_level_dn)
    red = frame.bayer_order.index("R")
    _fill_from_mosaic(
        np.ascontiguousarray(frame.mosaic), red // 2, red % 2, np.float32(frame.black_level_dn), scale,
        math.ceil(limit), np.ascontiguousarray(divisor), image.values, image.valid, image.clipped,
    )  # fmt: skip
    return image


def stored_intensity(
    pixels: Pixels, light: Float32Array, divisor: Float32Array, out: IntensityImage | None = None
) -> IntensityImage:
    """Intensity of an RGB image as it was stored, in `out` when it is given.

    pixels : uint8 or uint16 array of shape (H, W, 3)
    light : float32 array, share of full scale of each stored value (`frame_reading.light_of_values`)
    divisor : as for `raw_intensity`

    Raises
    ------
    CalibrationMismatch
        The image's size differs from the reference's.
    """
    check_same_size(pixels.shape[:2], divisor)
    image = out or empty_intensity((pixels.shape[0], pixels.shape[1]))
    _fill_from_stored(
        np.ascontiguousarray(pixels), light, np.ascontiguousarray(divisor), image.values, image.valid, image.clipped
    )
    return image


@njit(cache=True, parallel=True)
def _fill_from_mosaic(
    mosaic: Any, red_row: int, red_column: int, black: Any, scale: Any, limit: int,
    divisor: Any, values: Any, valid: Any, clipped: Any,
) -> None:  # fmt: skip
    """Write intensity, validity and clipping of every pixel; red stands at (red_row, red_column) of each 2x2 block."""
    rows, columns = mosaic.shape
    for band in prange((rows + _BAND_ROWS - 1) // _BAND_ROWS):
        counts = np.empty((3, columns), np.float32)
        highest = np.empty(columns, np.uint16)
        for r in range(band * _BAND_ROWS, min((band + 1) * _BAND_ROWS, rows)):
            inner = min(max(r, 1), rows - 2)
            own = 0 if inner % 2 == red_row else 2
            first = red_column if own == 0 else 1 - red_column
            _interpolate_row(
                mosaic[inner - 1], mosaic[inner], mosaic[inner + 1], first, counts[own], counts[1], counts[2 - own]
            )
            _divide_row(counts, black, scale, divisor[r], values[r], valid[r])
            _highest_row(mosaic[max(r - 1, 0)], mosaic[r], mosaic[min(r + 1, rows - 1)], highest)
            for c in range(columns):
                most = max(highest[max(c - 1, 0)], highest[c], highest[min(c + 1, columns - 1)])
                clipped[r, c] = most >= limit


@njit(cache=True)
def _interpolate_row(above: Any, here: Any, below: Any, first: int, own: Any, green: Any, other: Any) -> None:
    """Write the colours of a row by bilinear interpolation, rounded to whole counts as OpenCV does.

    The outermost pixels repeat their inner neighbours. Every column computes what both kinds of site need and keeps
    its own: only so does the loop become SIMD code.

    first : column, 0 or 1, of the first pixel of the colour that this row of the mosaic shares with green
    own, green, other : float32 arrays of shape (W,), that colour, green, and the colour of the rows beside
    """
    columns = here.size
    for c in range(1, columns - 1):
        mine, left, right = np.int32(here[c]), np.int32(here[c - 1]), np.int32(here[c + 1])
        up, down = np.int32(above[c]), np.int32(below[c])
        corners = np.int32(above[c - 1]) + np.int32(above[c + 1]) + np.int32(below[c - 1]) + np.int32(below[c + 1])
        at_own = (c & 1) == first
        own[c] = mine if at_own else (left + right + 1) >> 1
        green[c] = (left + right + up + down + 2) >> 2 if at_own else mine
        other[c] = (corners + 2) >> 2 if at_own else (up + down + 1) >> 1
    for colour in (own, green, other):
        colour[0], colour[columns - 1] = colour[1], colour[columns - 2]


@njit(cache=True)
def _divide_row(counts: Any, black: Any, scale: Any, divisor: Any, values: Any, valid: Any) -> None:
    floor = np.float32(DARK_FLOOR)
    for c in range(valid.size):
        lit = True
        for k in range(3):
            rest = divisor[c, k]
            lit = lit and rest > floor
            values[c, k] = (counts[k, c] - black) * scale / max(rest, floor)
        valid[c] = lit


@njit(cache=True)
def _highest_row(above: Any, here: Any, below: Any, highest: Any) -> None:
    for c in range(here.size):
        highest[c] = max(above[c], here[c], below[c])


@njit(cache=True, parallel=True)
def _fill_from_stored(pixels: Any, light: Any, divisor: Any, values: Any, valid: Any, clipped: Any) -> None:
    """Write intensity, validity and clipping of every pixel of an RGB image."""
    rows, columns, _ = pixels.shape
    floor, saturated = np.float32(DARK_FLOOR), np.float32(SATURATED)
    for r in prange(rows):
        for c in range(columns):
            lit, full = True, False
            for k in range(3):
                rest, share = divisor[r, c, k], light[pixels[r, c, k]]
                lit = lit and rest > floor
                full = full or share >= saturated
                values[r, c, k] = share / max(rest, floor)
            valid[r, c] = lit
            clipped[r, c] = full
