"""From stored counts to intensity in one pass over memory: black level, demosaicing, division by the reference.

The same arithmetic as `demosaic` and `flat_field_correct` in `device.imaging.flat_field`, bit for bit, without
full-size intermediate frames; tests compare the two. One thread computes each band of rows, so the result does not
depend on the number of threads.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from device.imaging.flat_field import (
    DARK_FLOOR,
    EXPOSURE_STEP,
    SATURATED,
    NormalizedImage,
    check_exposed_sample,
    check_same_size,
    demosaic,
    flat_field_correct,
)
from device.imaging.frame_light import FrameLight
from device.surface import Float32Array
from hal.frame import RawFrame
from host_sync.frames.image_info import Pixels
from host_sync.kernels.cell_rows import as_stored, colour_rows, empty_planes
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

_MIN_SIDE: Final = 4
"""Smaller mosaics have no pixel with all its neighbours; the portable path takes them."""


def empty_intensity(shape: tuple[int, int]) -> NormalizedImage:
    """Return an image of shape (H, W) for the functions below to fill, again and again; its pixels mean nothing yet."""
    return NormalizedImage(empty_planes(shape), np.empty(shape, np.bool_), np.empty(shape, np.bool_))


def raw_intensity(frame: RawFrame, flat_field: Float32Array, out: NormalizedImage | None = None) -> NormalizedImage:
    """Return the intensity of a raw frame, `flat_field_correct(demosaic(frame), flat_field)`, in `out` if it is given.

    flat_field : float32 array of shape (H, W, 3), `make_flat_field` or `estimate_flat_field`

    Raises
    ------
    CalibrationMismatch
        The frame's size differs from the reference's.
    """
    check_same_size(frame.shape, flat_field)
    if min(frame.shape) < _MIN_SIDE:
        return flat_field_correct(demosaic(frame), flat_field)
    image = out or empty_intensity(frame.shape)
    scale = np.float32(1.0 / (frame.white_level_dn - frame.black_level_dn))
    limit = frame.black_level_dn + SATURATED * (frame.white_level_dn - frame.black_level_dn)
    red = frame.bayer_order.index("R")
    parallel_rows(
        _fill_from_mosaic, frame.shape,
        np.ascontiguousarray(frame.mosaic), red // 2, red % 2, np.float32(frame.black_level_dn), scale,
        math.ceil(limit), *as_stored(flat_field), np.moveaxis(image.values, -1, 0), image.valid, image.clipped,
    )  # fmt: skip
    return image


def stored_intensity(
    pixels: Pixels, light: Float32Array, flat_field: Float32Array, out: NormalizedImage | None = None
) -> NormalizedImage:
    """Return the intensity of an RGB image as it was stored, in `out` when it is given.

    pixels : uint8 or uint16 array of shape (H, W, 3)
    light : float32 array, share of full scale of each stored value (`host_sync.frames.linear_light.light_of_values`)
    flat_field : as for `raw_intensity`

    Raises
    ------
    CalibrationMismatch
        The image's size differs from the reference's.
    """
    check_same_size(pixels.shape[:2], flat_field)
    image = out or empty_intensity((pixels.shape[0], pixels.shape[1]))
    parallel_rows(
        _fill_from_stored, image.shape,
        np.ascontiguousarray(pixels), light, *as_stored(flat_field), np.moveaxis(image.values, -1, 0), image.valid,
        image.clipped,
    )  # fmt: skip
    return image


@njit(cache=True, nogil=True)
def _fill_from_mosaic(
    mosaic: Any, red_row: int, red_column: int, black: Any, scale: Any, limit: int,
    flat_field: Any, by_plane: bool, values: Any, valid: Any, clipped: Any, begin: int, end: int,
) -> None:  # fmt: skip
    """Write intensity, validity and clipping of the rows `begin` to `end` - 1.

    red_row, red_column : where red stands in each 2x2 block
    """
    rows, columns = mosaic.shape
    counts, rest = np.empty((3, columns), np.float32), np.empty((3, columns), np.float32)
    highest = np.empty(columns, np.uint16)
    for r in range(begin, end):
        inner = min(max(r, 1), rows - 2)
        own = 0 if inner % 2 == red_row else 2
        first = red_column if own == 0 else 1 - red_column
        _interpolate_row(
            mosaic[inner - 1], mosaic[inner], mosaic[inner + 1], first, counts[own], counts[1], counts[2 - own]
        )
        red, green, blue = colour_rows(flat_field, by_plane, r, 0, columns, rest)
        _divide_row(counts[0], black, scale, red, values[0, r])
        _divide_row(counts[1], black, scale, green, values[1, r])
        _divide_row(counts[2], black, scale, blue, values[2, r])
        _lit_row(red, green, blue, valid[r])
        _highest_row(mosaic[max(r - 1, 0)], mosaic[r], mosaic[min(r + 1, rows - 1)], highest)
        _clip_row(highest, limit, clipped[r])


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


@njit(cache=True, error_model="numpy")
def _divide_row(counts: Any, black: Any, scale: Any, flat_field: Any, values: Any) -> None:
    """Write a row's intensity in one colour."""
    floor = np.float32(DARK_FLOOR)
    for c in range(values.size):
        values[c] = (counts[c] - black) * scale / max(flat_field[c], floor)


@njit(cache=True)
def _lit_row(red: Any, green: Any, blue: Any, valid: Any) -> None:
    """Write where all three colours of the flat field are bright enough to divide by."""
    floor = np.float32(DARK_FLOOR)
    for c in range(valid.size):
        valid[c] = (red[c] > floor) & (green[c] > floor) & (blue[c] > floor)


@njit(cache=True)
def _highest_row(above: Any, here: Any, below: Any, highest: Any) -> None:
    for c in range(here.size):
        highest[c] = max(above[c], here[c], below[c])


@njit(cache=True)
def _clip_row(highest: Any, limit: Any, clipped: Any) -> None:
    """Write where the highest count of a pixel and its neighbours reaches the limit."""
    last = highest.size - 1
    for c in range(1, last):
        clipped[c] = max(highest[c - 1], highest[c], highest[c + 1]) >= limit
    clipped[0] = max(highest[0], highest[1]) >= limit
    clipped[last] = max(highest[last - 1], highest[last]) >= limit


@njit(cache=True, nogil=True)
def _fill_from_stored(
    pixels: Any, light: Any, flat_field: Any, by_plane: bool, values: Any, valid: Any, clipped: Any,
    begin: int, end: int,
) -> None:  # fmt: skip
    """Write intensity, validity and clipping of the rows `begin` to `end` - 1 of an RGB image."""
    columns = pixels.shape[1]
    spare = np.empty((3, columns), np.float32)
    for r in range(begin, end):
        red, green, blue = colour_rows(flat_field, by_plane, r, 0, columns, spare)
        clipped[r, :] = False
        _stored_row(pixels[r], 0, light, red, values[0, r], clipped[r])
        _stored_row(pixels[r], 1, light, green, values[1, r], clipped[r])
        _stored_row(pixels[r], 2, light, blue, values[2, r], clipped[r])
        _lit_row(red, green, blue, valid[r])


@njit(cache=True, error_model="numpy")
def _stored_row(pixels: Any, colour: int, light: Any, flat_field: Any, values: Any, clipped: Any) -> None:
    """Write a row's intensity in one colour; mark where it is saturated."""
    floor, saturated = np.float32(DARK_FLOOR), np.float32(SATURATED)
    for c in range(values.size):
        share = light[pixels[c, colour]]
        clipped[c] = clipped[c] | (share >= saturated)
        values[c] = share / max(flat_field[c], floor)


def take_out_light(light: FrameLight, values: Float32Array, flat_field: Float32Array) -> None:
    """Do what `FrameLight.take_out` does to a whole image, in one pass over memory.

    values, flat_field : float32 arrays of shape (H, W, 3)
    """
    if light.change == 0.0 and light.stray == 0.0:
        return
    parallel_rows(
        _take_out_rows, (values.shape[0], values.shape[1]), np.moveaxis(flat_field, -1, 0),
        light.offsets.astype(np.float32), (1.0 / light.gains).astype(np.float32), np.moveaxis(values, -1, 0),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _take_out_rows(flat_field: Any, offsets: Any, factors: Any, values: Any, begin: int, end: int) -> None:
    floor = np.float32(DARK_FLOOR)
    for r in range(begin, end):
        for colour in range(3):
            offset, factor, rest, row = offsets[colour], factors[colour], flat_field[colour, r], values[colour, r]
            for c in range(row.size):
                row[c] = (row[c] - offset / max(rest[c], floor)) * factor


# Refuses a frame that cannot be read, from a sample of its intensity: black or saturated.


def check_exposure(intensity: NormalizedImage, flat_field: Float32Array, name: str, coarseness: int = 1) -> None:
    """Refuse what `check_exposed` refuses, without the linear frame.

    flat_field : float32 array of shape (H, W, 3), what the frame was divided by
    coarseness : how many times fewer rows and columns are looked at

    Raises
    ------
    FrameError
        The frame is black or saturated; names `name`.
    """
    clipped_share = np.count_nonzero(intensity.clipped) / intensity.clipped.size
    step = coarseness * EXPOSURE_STEP
    light = intensity.values[::step, ::step] * np.maximum(flat_field[::step, ::step], np.float32(DARK_FLOOR))
    check_exposed_sample(light, clipped_share, name)
