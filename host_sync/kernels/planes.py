"""Access to the planes of colour images in kernels.

An image has shape (H, W, 3) everywhere. Most are stored pixel by pixel, as OpenCV needs them, but separating colours
takes kernels more time than the arithmetic. Kernels therefore store their own images plane by plane, as an array of
shape (3, H, W) with its axes moved, which behaves the same everywhere else.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from device.surface import Float32Array
from host_sync.kernels.jit import njit


def empty_planes(shape: tuple[int, int]) -> Float32Array:
    """Uninitialized float32 array of shape (H, W, 3), stored plane by plane."""
    return np.moveaxis(np.empty((3, *shape), np.float32), 0, -1)


def in_planes(image: Float32Array) -> Float32Array:
    """Return the image, of shape (H, W, 3), stored plane by plane: itself or a copy."""
    return np.moveaxis(np.ascontiguousarray(np.moveaxis(image, -1, 0)), 0, -1)


def as_stored(image: Float32Array) -> tuple[Float32Array, bool]:
    """Return the image (H, W, 3) as a C-contiguous array, and whether that holds planes, (3, H, W)."""
    planes = np.moveaxis(image, -1, 0)
    if planes.flags.c_contiguous:
        return planes, True
    return np.ascontiguousarray(image), False


@njit(cache=True)
def colour_rows(stored: Any, by_plane: bool, row: int, first: int, last: int, spare: Any) -> Any:
    """Return three colours of the columns `first` to `last` - 1 of a row, float32 arrays of shape (n,).

    stored, by_plane : as `as_stored` returns them
    spare : float32 array of shape (3, n) or more, used where pixels must be separated
    """
    if by_plane:
        return stored[0, row, first:last], stored[1, row, first:last], stored[2, row, first:last]
    red, green, blue = spare[0, : last - first], spare[1, : last - first], spare[2, : last - first]
    _separate(stored[row, first:last], red, green, blue)
    return red, green, blue


@njit(cache=True)
def _separate(pixels: Any, red: Any, green: Any, blue: Any) -> None:
    for c in range(red.size):
        red[c], green[c], blue[c] = pixels[c, 0], pixels[c, 1], pixels[c, 2]
