"""Pictures of camera frames and of height maps: relief, height scale in µm, length bar, and the profile at a cursor."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, HeightMap
from device.tui.drawing.cells import OWN, CellGrid, ColourDepth, colour_cells, fitted_shape, grey_cells, resampled
from device.tui.drawing.relief import (
    LEGEND_COLUMNS,
    HeightRange,
    ProfileCursor,
    legend_cells,
    length_bar,
    profile_cells,
    profile_um,
    reading,
    relief_cells,
)

PROFILE_ROWS: Final = 5
MIN_COLUMNS: Final = 24
MIN_ROWS: Final = 6
"""Below this size only the relief is drawn."""

_LINE: Final = 0xFFFFFF


@dataclass(frozen=True, slots=True)
class Room:
    """The cells available for a picture."""

    rows: int
    columns: int
    depth: ColourDepth


def height_picture(
    height: HeightMap, room: Room, cursor: ProfileCursor | None = None, origin: tuple[int, int] = (0, 0)
) -> CellGrid:
    """Return cells that fill the room: the relief as large as possible, with scale, bar and profile where they fit.

    origin : row and column of the first pixel in the whole map, for the stated position
    """
    heights = HeightRange.of(height.z_um)
    cells = CellGrid.empty(room.rows, room.columns, room.depth)
    rows, columns = relief_shape(height, room, cursor)
    relief = relief_cells(height, heights, (rows, columns), room.depth)
    if cursor:
        _draw_line(relief, cursor)
    cells.blit(0, 0, relief)
    if _is_small(room):
        return cells
    cells.blit(0, columns, legend_cells(heights, rows, room.depth))
    words = (
        reading(height, cursor, origin)
        if cursor
        else length_bar(height.pitch_um * height.z_um.shape[1] / columns, columns)
    )
    cells.write(rows, 0, words)
    if cursor and _fits_profile(room):
        bars = profile_cells(profile_um(height, cursor), cursor.point, PROFILE_ROWS, columns, room.depth)
        cells.blit(rows + 1, 0, bars)
    return cells


def relief_shape(height: HeightMap, room: Room, cursor: ProfileCursor | None) -> tuple[int, int]:
    """(rows, columns) of the relief in the room."""
    if _is_small(room):
        return fitted_shape(height.z_um.shape, max(room.rows, 1), max(room.columns, 1))
    below = 1 + (PROFILE_ROWS if cursor and _fits_profile(room) else 0)
    return fitted_shape(height.z_um.shape, room.rows - below, room.columns - LEGEND_COLUMNS)


def picture_rows(height: HeightMap, room: Room, cursor: ProfileCursor | None) -> int:
    """Return the number of rows that the picture uses."""
    rows = relief_shape(height, room, cursor)[0]
    below = 0 if _is_small(room) else 1 + (PROFILE_ROWS if cursor and _fits_profile(room) else 0)
    return min(rows + below, room.rows)


def sentence_cells(sentence: str, room: Room) -> CellGrid:
    """Return a sentence centred in the room, shown instead of a map."""
    cells = CellGrid.empty(room.rows, room.columns, room.depth)
    lines = textwrap.wrap(sentence, max(min(room.columns - 4, 44), 8))
    for row, line in enumerate(lines, start=max((room.rows - len(lines)) // 2, 0)):
        cells.write(row, max((room.columns - len(line)) // 2, 0), line)
    return cells


def _is_small(room: Room) -> bool:
    return room.columns < MIN_COLUMNS or room.rows < MIN_ROWS


def _fits_profile(room: Room) -> bool:
    return room.rows >= MIN_ROWS + PROFILE_ROWS


def _draw_line(relief: CellGrid, cursor: ProfileCursor) -> None:
    """Draw a dashed line with its point; in full colour the relief shows through."""
    rows, columns = relief.shape
    across, along = (rows, columns) if cursor.axis == "row" else (columns, rows)
    line, point = round(cursor.line * (across - 1)), round(cursor.point * (along - 1))
    for place in {*range(0, along, 2), point}:
        row, column = (line, place) if cursor.axis == "row" else (place, line)
        glyph = "+" if place == point else "─" if cursor.axis == "row" else "│"
        paper = int(relief.paper[row, column])
        relief.write(row, column, glyph, bold=True)
        if relief.depth == "full":
            relief.ink[row, column], relief.paper[row, column] = _LINE, paper


# The live picture as cells, with circles around detected balls and at the next place.

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


# Interval between live pictures, adapted to the terminal.

MAX_INTERVAL_S: Final = 2.0

_LATE_FRACTION: Final = 0.5

_CALM_TICKS: Final = 20


class FrameRateLimiter:
    """The interval between live pictures, adapted to the terminal.

    A terminal that is slow to accept output delays the next tick; every late tick doubles the interval, and it is
    halved again after a while without one.

    Parameters
    ----------
    interval_s : the shortest interval
    """

    def __init__(self, interval_s: float) -> None:
        self._shortest_s = interval_s
        self._interval_s = interval_s
        self._drawn_s: float | None = None
        self._calm = 0

    @property
    def interval_s(self) -> float:
        """The present interval."""
        return self._interval_s

    def is_due(self, now_s: float) -> bool:
        """Return whether a picture is due at this time; it then counts as drawn."""
        if self._drawn_s is not None and now_s - self._drawn_s < self._interval_s * (1.0 - 1e-6):
            return False
        self._drawn_s = now_s
        return True

    def tick(self, late_s: float) -> None:
        """Record by how much a tick was late."""
        if late_s > _LATE_FRACTION * self._interval_s:
            self._interval_s = min(2.0 * self._interval_s, MAX_INTERVAL_S)
            self._calm = 0
            return
        self._calm += 1
        if self._calm >= _CALM_TICKS:
            self._interval_s = max(self._interval_s / 2.0, self._shortest_s)
            self._calm = 0
