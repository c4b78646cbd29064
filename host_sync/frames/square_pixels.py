"""Frames of pixels that are not square, brought to square ones where they are read.

A stream that was resized in one direction, or a sensor with oblong pixels, has another pitch along rows than down
columns. The finer direction is averaged to the pitch of the coarser one: no value is made up, and all else sees square
pixels of one pitch.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import LinearFrame
from host_sync.errors import FrameSetError

MAX_OBLONG: Final = 3.0
"""A field of an interlaced stream, or a sensor binned in one direction, has pixels twice as high as wide."""


def square_pitch(pitch_um: float | tuple[float, ...]) -> tuple[float, float]:
    """Return the pitch of the square pixels, and the shape of the stored ones: height over width.

    pitch_um : distance of neighbouring pixels on the skin, µm; where they are not square, along a row and down a column

    Raises
    ------
    FrameSetError
        The two differ by more than any camera's.
    """
    if isinstance(pitch_um, tuple):
        across_um, down_um = pitch_um
        if max(across_um, down_um) > MAX_OBLONG * min(across_um, down_um):
            raise FrameSetError(
                f"pixel_pitch_um: [{across_um:g}, {down_um:g}] are no two pitches of one camera: write decimal points, "
                f"such as {across_um:g}.5 for one pitch, or the pitch along a row and the one down a column"
            )
        return max(across_um, down_um), down_um / across_um
    return pitch_um, 1.0


def square_shape(shape: tuple[int, int], pixel_shape: float) -> tuple[int, int]:
    """(H, W) of a frame in square pixels that is stored with (H, W) `shape`."""
    rows, columns = shape
    if pixel_shape > 1.0:
        return rows, max(1, round(columns / pixel_shape))
    return max(1, round(rows * pixel_shape)), columns


def square_place(column: float, row: float, shape: tuple[int, int], pixel_shape: float) -> tuple[float, float]:
    """Return the column and row in square pixels of a place in a frame that is stored with (H, W) `shape`."""
    rows, columns = square_shape(shape, pixel_shape)
    return (column + 0.5) * columns / shape[1] - 0.5, (row + 0.5) * rows / shape[0] - 0.5


def square_frame(frame: LinearFrame, pixel_shape: float) -> LinearFrame:
    """Return the frame in square pixels; one is clipped where any part of it is."""
    if pixel_shape == 1.0:
        return frame
    rows, columns = square_shape(frame.shape, pixel_shape)
    size = (columns, rows)
    rgb = cv2.resize(frame.rgb, size, interpolation=cv2.INTER_AREA).reshape(rows, columns, -1)
    clipped = cv2.resize(frame.clipped.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
    return LinearFrame(np.asarray(rgb, np.float32), np.asarray(clipped, np.bool_), frame.demosaiced)
