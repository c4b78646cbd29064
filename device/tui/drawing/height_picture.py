"""The picture of a height map: relief, height scale in µm, length bar, and the profile at a cursor."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import Final

from device.surface.fields import HeightMap
from device.tui.drawing.cells import CellGrid, ColourDepth, fitted_shape
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
