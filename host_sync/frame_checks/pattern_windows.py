"""Windows spread over the field, and the fine bands of the light in them: what a skin's pigment shows.

The windows lie symmetrically about the field's centre, so that the windows of a turned or mirrored frame are the turned
or mirrored windows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.surface.fields import Float32Array

SIDE_PX: Final = 128
MAX_ACROSS: Final = 8
MAX_DOWN: Final = 6

BAND_PX: Final = (1.0, 2.0, 4.0)
"""Standard deviations of the Gaussians whose differences are the fine and the coarse band, pixels."""

EDGE_PX: Final = 8
"""So many pixels along a window's border are left out: the Gaussians mix in what lies beside it."""

VARIANCE_PX: Final = 17
"""Side of the box over which a band's local variance is taken, pixels."""

VARIANCE_FLOOR: Final = 0.25
CLIP_SIGMAS: Final = 3.0
"""Local variances below this share of their median count as that much; values beyond so many of their standard
deviations are cut: an edge of the object must not outweigh the pattern."""


@dataclass(frozen=True, slots=True)
class WindowGrid:
    """Where the windows of a field of shape (H, W) begin.

    rows, columns : of each window's first pixel
    side : of a window, pixels
    """

    rows: tuple[int, ...]
    columns: tuple[int, ...]
    side: int

    @classmethod
    def of(cls, shape: tuple[int, int]) -> WindowGrid:
        """The grid of a field; windows of small fields are smaller, so that there are at least two by two."""
        side = min(SIDE_PX, min(shape) // 2)
        down, across = (min(most, size // side) for most, size in ((MAX_DOWN, shape[0]), (MAX_ACROSS, shape[1])))
        return cls(_starts(shape[0], down, side), _starts(shape[1], across, side), side)

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.rows) * len(self.columns)


def _starts(size: int, count: int, side: int) -> tuple[int, ...]:
    """First pixels of `count` windows, the last mirrored to the first about the middle."""
    half = [round(i * (size - side) / (count - 1)) for i in range((count + 1) // 2)]
    return tuple(half + [size - side - half[i] for i in reversed(range(count // 2))])


def window_light(image: NormalizedImage, flat_field: Float32Array, grid: WindowGrid) -> Float32Array:
    """Log of the light of all channels in the windows, laid side by side: float32 array (rows · side, columns · side).

    flat_field : float32 array of shape (H, W, 3), what the frame was divided by
    """
    side = grid.side
    light = np.empty((len(grid.rows) * side, len(grid.columns) * side), np.float32)
    for i, row in enumerate(grid.rows):
        for j, column in enumerate(grid.columns):
            here = (slice(row, row + side), slice(column, column + side))
            light[i * side : (i + 1) * side, j * side : (j + 1) * side] = np.einsum(
                "ijc,ijc->ij", image.values[here], flat_field[here]
            )
    return np.asarray(np.log(np.maximum(light, np.float32(3.0 * DARK_FLOOR))), np.float32)


def light_bands(light: Float32Array) -> tuple[Float32Array, Float32Array]:
    """The fine and the coarse band of log light, arrays of its shape."""
    blurred = [cv2.GaussianBlur(light, (0, 0), sigma) for sigma in BAND_PX]
    return np.asarray(blurred[0] - blurred[1], np.float32), np.asarray(blurred[1] - blurred[2], np.float32)


def weighted(band: Float32Array) -> tuple[Float32Array, Float32Array]:
    """A band over its local variance, its large values cut, and one over that variance: arrays of its shape."""
    variance = cv2.blur(band * band, (VARIANCE_PX, VARIANCE_PX))
    floor = VARIANCE_FLOOR * float(np.median(variance[::4, ::4]))
    weight = np.float32(1.0) / np.maximum(variance, np.float32(max(floor, 1e-12)))
    reach = np.float32(CLIP_SIGMAS) / np.sqrt(weight)
    return np.asarray(np.clip(band, -reach, reach) * weight, np.float32), np.asarray(weight, np.float32)


def in_windows(laid: Float32Array, grid: WindowGrid) -> Float32Array:
    """Windows laid side by side as an array of shape (N, side, side), zero along each window's border."""
    side = grid.side
    down, across = len(grid.rows), len(grid.columns)
    windows = laid.reshape(down, side, across, side).swapaxes(1, 2).reshape(down * across, side, side)
    inner = np.zeros((side, side), np.float32)
    inner[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX] = 1.0
    return np.asarray(windows * inner, np.float32)
