"""Rows of images inside kernels: planes of colour images, and values of cells interpolated to every pixel.

An image has shape (H, W, 3) everywhere. Most are stored pixel by pixel, as OpenCV needs them, but separating colours
takes kernels more time than the arithmetic. Kernels therefore store their own images plane by plane, as an array of
shape (3, H, W) with its axes moved, which behaves the same everywhere else.

Values of cells are linear between the middles of cells, and constant beyond the outermost ones. What two rows of cells
hold is first brought to every column. All rows of pixels between their middles then take it, so that a pixel costs one
product a value.
"""

from __future__ import annotations

from itertools import product
from typing import Any, Final

import cv2
import numpy as np

from device.surface import Float32Array, Float64Array
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


WIDEST_CELLS: Final = 256
"""Cells along the columns of a reduced field, at most."""


WHOLE_CELL: Final = 0.999
"""Fraction of a cell's pixels that are faithful in a cell whose intensity counts."""


def cell_px(shape: tuple[int, ...]) -> int:
    """Return pixels along a cell of a field of `shape` (H, W)."""
    return -(-shape[1] // WIDEST_CELLS)


def middles_of_cells(size: tuple[int, ...], cell: int) -> tuple[Float64Array, Float64Array]:
    """Return rows and columns of the middles of `size` (h, w) cells of `cell` x `cell` pixels, shape (h,) and (w,)."""
    rows, columns = (np.arange(count, dtype=np.float64) * cell + 0.5 * (cell - 1) for count in size[:2])
    return np.asarray(rows), np.asarray(columns)


def means_of_cells(values: Float32Array, size: tuple[int, int], cell: int) -> Float64Array:
    """Return means over cells of values (H, W, C), float64 array of shape (h, w, C)."""
    channels = [_means(np.ascontiguousarray(plane), size, cell) for plane in np.moveaxis(values, -1, 0)]
    return np.stack(channels, axis=-1).astype(np.float64)


def _means(plane: Float32Array, size: tuple[int, int], cell: int) -> Float32Array:
    """Return means over cells of a plane (H, W), whose last row and column are repeated to the end of a cell."""
    found = np.empty(size, np.float32)
    cells = (_whole_and_cut(pixels, count, cell) for pixels, count in zip(plane.shape, size, strict=True))
    for down, across in product(*cells):
        part = plane[down.start * cell : down.stop * cell, across.start * cell : across.stop * cell]
        rows, columns = down.stop - down.start, across.stop - across.start
        below, right = rows * cell - part.shape[0], columns * cell - part.shape[1]
        if below or right:
            part = np.asarray(cv2.copyMakeBorder(part, 0, below, 0, right, cv2.BORDER_REPLICATE), np.float32)
        found[down, across] = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA)
    return found


def _whole_and_cut(pixels: int, count: int, cell: int) -> list[slice]:
    """Return the cells that lie within the field, and those that its border cuts, as slices.

    Only those that are cut need a copy of their pixels.
    """
    whole = pixels // cell
    return [part for part in (slice(0, whole), slice(whole, count)) if part.stop > part.start]


def bordered(planes: Float32Array) -> Float32Array:
    """Return planes of cells (T, h, w) with the border cells repeated around them: (T, h + 2, w + 2)."""
    return np.ascontiguousarray(np.pad(planes, ((0, 0), (1, 1), (1, 1)), mode="edge"), np.float32)


@njit(cache=True)
def cells_above(row: int, cell: int, count: int) -> Any:
    """Return the index of the bordered row of cells above a row of pixels, and the fraction of the way down.

    The middle of the cells lies above; the way leads to the middle of the next row of cells.
    """
    at = (row - 0.5 * (cell - 1)) / cell + 1.0
    top = min(max(int(at), 0), count - 2)
    return top, np.float32(at - top)


@njit(cache=True)
def expanded_at(planes: Any, row: int, cell: int, expanded: int, upper: Any, step: Any) -> Any:
    """Return what `cells_above` returns, and bring that row of cells to all columns.

    A row that is there already is not brought again.

    expanded : the row that `upper` and `step`, as of `expand_cells`, hold; -1 for none
    """
    top, share = cells_above(row, cell, planes.shape[1])
    if top != expanded:
        expand_cells(planes, top, cell, 0, upper, step)
    return top, share


@njit(cache=True)
def expand_cells(planes: Any, top: int, cell: int, first: int, upper: Any, step: Any) -> None:
    """Bring a bordered row of cells to the columns from `first` on.

    planes : float32 array of shape (T, h + 2, w + 2)
    upper, step : float32 arrays of shape (T, columns), receive row `top` and by how much the next one is larger
    """
    columns, cells = upper.shape[1], planes.shape[2]
    per_cell, middle = np.float32(1.0 / cell), 0.5 * (cell - 1) - first
    left, right = max(int(-middle / cell), 0), min(int((columns - middle) / cell) + 2, cells - 1)
    for term in range(len(planes)):
        above, below = planes[term, top], planes[term, top + 1]
        for j in range(left, right):
            begin = (j - 1) * cell + middle
            start, end = max(int(np.ceil(begin)), 0), min(int(np.ceil(begin + cell)), columns)
            offset = np.float32(start - begin)
            here, across = above[j], (above[j + 1] - above[j]) * per_cell
            down = below[j] - here
            turn = (below[j + 1] - below[j]) * per_cell - across
            for c in range(start, end):
                along = offset + np.float32(c - start)
                upper[term, c] = here + along * across
                step[term, c] = down + along * turn
