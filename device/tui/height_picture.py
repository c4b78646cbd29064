"""A whole picture of a height map: relief, scale in µm, bar of length, and under a cursor the profile."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import Final

from device.surface import HeightMap
from device.tui.cells import Cells
from device.tui.legend import LEGEND_COLUMNS, legend_cells, length_bar
from device.tui.profile import ProfileCursor, profile_cells, profile_um, reading
from device.tui.relief import HeightRange, relief_cells
from device.tui.resampling import fitted_shape
from device.tui.terminal import ColourDepth

PROFILE_ROWS: Final = 5
LEAST_COLUMNS: Final = 24
LEAST_ROWS: Final = 6
"""In less room there is only the relief."""

_LINE: Final = 0xFFFFFF


@dataclass(frozen=True, slots=True)
class RoomForHeight:
    """The cells that a picture may fill."""

    rows: int
    columns: int
    depth: ColourDepth


def height_picture(height: HeightMap, room: RoomForHeight, cursor: ProfileCursor | None = None) -> Cells:
    """Cells that fill the room: the relief as large as fits, and around it what its size allows."""
    heights = HeightRange.of(height.z_um)
    cells = Cells.blank(room.rows, room.columns, room.depth)
    rows, columns = relief_shape(height, room, cursor)
    relief = relief_cells(height, heights, (rows, columns), room.depth)
    if cursor:
        _draw_line(relief, cursor)
    cells.paste(0, 0, relief)
    if _is_small(room):
        return cells
    cells.paste(0, columns, legend_cells(heights, rows, room.depth))
    words = reading(height, cursor) if cursor else length_bar(height.pitch_um * height.z_um.shape[1] / columns, columns)
    cells.write(rows, 0, words)
    if cursor and _fits_profile(room):
        bars = profile_cells(profile_um(height, cursor), cursor.point, PROFILE_ROWS, columns, room.depth)
        cells.paste(rows + 1, 0, bars)
    return cells


def relief_shape(height: HeightMap, room: RoomForHeight, cursor: ProfileCursor | None) -> tuple[int, int]:
    """(rows, columns) of the relief within the room."""
    if _is_small(room):
        return fitted_shape(height.z_um.shape, max(room.rows, 1), max(room.columns, 1))
    below = 1 + (PROFILE_ROWS if cursor and _fits_profile(room) else 0)
    return fitted_shape(height.z_um.shape, room.rows - below, room.columns - LEGEND_COLUMNS)


def picture_rows(height: HeightMap, room: RoomForHeight, cursor: ProfileCursor | None) -> int:
    """Rows that the picture fills of the room."""
    rows = relief_shape(height, room, cursor)[0]
    below = 0 if _is_small(room) else 1 + (PROFILE_ROWS if cursor and _fits_profile(room) else 0)
    return min(rows + below, room.rows)


def sentence_cells(sentence: str, room: RoomForHeight) -> Cells:
    """A sentence in the middle of the room, for want of a map."""
    cells = Cells.blank(room.rows, room.columns, room.depth)
    lines = textwrap.wrap(sentence, max(min(room.columns - 4, 44), 8))
    for row, line in enumerate(lines, start=max((room.rows - len(lines)) // 2, 0)):
        cells.write(row, max((room.columns - len(line)) // 2, 0), line)
    return cells


def _is_small(room: RoomForHeight) -> bool:
    return room.columns < LEAST_COLUMNS or room.rows < LEAST_ROWS


def _fits_profile(room: RoomForHeight) -> bool:
    return room.rows >= LEAST_ROWS + PROFILE_ROWS


def _draw_line(relief: Cells, cursor: ProfileCursor) -> None:
    """A dashed line through the relief, and its point; in full colour the relief shows behind it."""
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
