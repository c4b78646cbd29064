"""The live picture as cells, with circles around detected balls and at the next place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array
from device.tui.drawing.cells import OWN, CellGrid, ColourDepth, colour_cells, fitted_shape, grey_cells, resampled

Mark = Literal["found", "wanted", "refused"]

_SEEN: Final = 8.0
"""Difference of a colour that is shown; colours have 5 bits."""

_SLOWLY: Final = 0.2
_MIN_CONTRAST: Final = 0.25
_GLYPHS: Final[dict[Mark, str]] = {"found": "o", "wanted": ".", "refused": "x"}
_INKS: Final[dict[Mark, int]] = {"found": 0x7FE0A0, "wanted": 0xFFD27F, "refused": 0xFF8F8F}
_BRIGHT: Final[dict[Mark, int]] = {"found": 10, "wanted": 11, "refused": 9}


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle on the field; column and radius are fractions of its columns, row of its rows.

    label : written at the centre
    """

    mark: Mark
    column: float
    row: float
    radius: float
    label: str = ""


def shown_colours(
    picture: NDArray[np.uint8], rows: int, columns: int, before: Float32Array | None = None
) -> Float32Array:
    """Return colours of a live picture, uint8 array (h, w, 3), in at most `rows` x `columns` cells, two a cell.

    before : colours that are shown; one that hardly differs stays, so that noise sends nothing to the terminal
    """
    shape = fitted_shape(picture.shape[:2], rows, columns)
    size = (2 * shape[0], shape[1])
    colours = np.stack([resampled(picture[..., i].astype(np.float32), size) for i in range(3)], axis=-1)
    if before is None or before.shape != colours.shape:
        return colours
    return np.where(np.abs(colours - before).max(axis=-1, keepdims=True) > _SEEN, colours, before)


def frame_cells(colours: Float32Array, depth: ColourDepth, circles: Iterable[Circle] = ()) -> CellGrid:
    """Return cells of a live picture's colours, with circles on it."""
    cells = _cells(colours, depth)
    for circle in circles:
        _draw(cells, circle)
    return cells


def _cells(colours: Float32Array, depth: ColourDepth) -> CellGrid:
    """In colour with 5 bits per channel, so that few styles are needed; otherwise grey, from one light."""
    valid = np.ones(colours.shape[:2], np.bool_)
    if depth != "full":
        return grey_cells(_one_light(colours[..., 0]), valid, depth)
    red, green, blue = np.moveaxis(colours.astype(np.int32) & 0xF8, -1, 0)
    return colour_cells(np.asarray((red << 16) | (green << 8) | blue, np.int32), valid)


def _one_light(red: Float32Array) -> Float32Array:
    """Return the brightness from 0 to 1 under the red light alone, as the sum of three lights hardly shows a relief.

    The light's slow fall-off is divided out.
    """
    even = red / np.maximum(cv2.GaussianBlur(red, (0, 0), _SLOWLY * red.shape[1]), np.float32(1.0))
    low, high = (float(value) for value in np.percentile(even, (1, 99)))
    span = max(high - low, _MIN_CONTRAST)
    return np.asarray(np.float32(0.5) + (even - np.float32((low + high) / 2.0)) / np.float32(span), np.float32)


def _draw(cells: CellGrid, circle: Circle) -> None:
    rows, columns = cells.shape
    centre_row, centre_column = circle.row * rows - 0.5, circle.column * columns - 0.5
    radius = circle.radius * columns
    steps = max(int(8 * radius), 8)
    for angle in np.linspace(0.0, 2.0 * np.pi, steps, endpoint=False):
        row, column = centre_row + 0.5 * radius * np.sin(angle), centre_column + radius * np.cos(angle)
        _mark(cells, round(row), round(column), _GLYPHS[circle.mark], circle.mark)
    first = round(centre_column - (len(circle.label) - 1) / 2.0)
    for place, glyph in enumerate(circle.label, start=first):
        _mark(cells, round(centre_row), place, glyph, circle.mark)


def _mark(cells: CellGrid, row: int, column: int, glyph: str, mark: Mark) -> None:
    rows, columns = cells.shape
    if not (0 <= row < rows and 0 <= column < columns):
        return
    paper = int(cells.paper[row, column])
    cells.write(row, column, glyph, bold=True)
    if cells.depth == "full":
        cells.ink[row, column], cells.paper[row, column] = _INKS[mark], paper
    elif cells.depth == "sixteen":
        cells.ink[row, column], cells.paper[row, column] = _BRIGHT[mark], OWN
