"""The profile along a row or column of a height map, drawn as bars with a scale in µm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from device.surface.fields import Float32Array, HeightMap
from device.tui.drawing.cells import CellGrid, ColourDepth
from device.tui.drawing.half_blocks import HATCH
from device.tui.drawing.legend import height_text
from device.tui.drawing.relief import HeightRange
from device.tui.drawing.resampling import resampled

Axis = Literal["row", "column"]

LABEL_COLUMNS: Final = 9
"""A blank and up to eight characters, such as "-1234 µm"."""

EIGHTHS: Final = " ▁▂▃▄▅▆▇█"
HALVES: Final = " ▄█"
"""The blocks in a plain console's font."""


@dataclass(frozen=True, slots=True)
class ProfileCursor:
    """A line across the map and a point on it.

    axis : direction of the line
    line : position of the line across the map, 0 to 1
    point : position of the point along the line, 0 to 1
    """

    axis: Axis = "row"
    line: float = 0.5
    point: float = 0.5

    def moved(self, across: float, along: float) -> ProfileCursor:
        """The cursor moved by these fractions of the map, kept on it."""
        return ProfileCursor(self.axis, _within(self.line + across), _within(self.point + along))

    def turned(self) -> ProfileCursor:
        """The line through the same point in the other direction."""
        return ProfileCursor("column" if self.axis == "row" else "row", self.point, self.line)


def _within(fraction: float) -> float:
    return min(max(fraction, 0.0), 1.0)


def profile_um(height: HeightMap, cursor: ProfileCursor) -> Float32Array:
    """Heights along the cursor's line: float32 array of shape (n,), µm, NaN where invalid."""
    across = height.z_um if cursor.axis == "row" else height.z_um.T
    return np.asarray(across[round(cursor.line * (len(across) - 1))], np.float32)


def reading(height: HeightMap, cursor: ProfileCursor, origin: tuple[int, int] = (0, 0)) -> str:
    """Position and height at the cursor's point, such as "x 3.20 mm  y 6.10 mm  z 41.5 µm".

    origin : row and column of the map's first pixel in the whole
    """
    rows, columns = height.z_um.shape
    along_row = cursor.axis == "row"
    row = round((cursor.line if along_row else cursor.point) * (rows - 1))
    column = round((cursor.point if along_row else cursor.line) * (columns - 1))
    z_um = float(height.z_um[row, column])
    x_mm = (column + origin[1]) * height.pitch_um / 1e3
    y_mm = (row + origin[0]) * height.pitch_um / 1e3
    return f"x {x_mm:.2f} mm  y {y_mm:.2f} mm  z {f'{z_um:.1f} µm' if np.isfinite(z_um) else 'not measured'}"


def profile_cells(profile: Float32Array, point: float, rows: int, columns: int, depth: ColourDepth) -> CellGrid:
    """A profile as `columns` bars above its lowest height, with its range in µm at the right and its point below.

    profile : float32 array of shape (n,), µm
    point : position of the cursor's point, 0 to 1
    """
    cells = CellGrid.empty(rows, columns + LABEL_COLUMNS, depth)
    blocks = EIGHTHS if depth == "full" else HALVES
    heights = HeightRange.of(profile)
    z_um = resampled(profile[np.newaxis, :], (1, columns))[0]
    bars, parts = rows - 1, len(blocks) - 1
    filled = np.clip(np.round(heights.fraction(np.nan_to_num(z_um)) * bars * parts), 1, bars * parts).astype(np.int32)
    for row in range(bars):
        level = np.clip(filled - (bars - 1 - row) * parts, 0, parts)
        cells.glyphs[row, :columns] = np.where(np.isfinite(z_um), np.array(list(blocks))[level], HATCH)
    cells.write(bars, round(point * (columns - 1)), "▲", bold=True)
    cells.write(0, columns + 1, f"{height_text(heights.highest_um)} µm")
    cells.write(bars - 1, columns + 1, f"{height_text(heights.lowest_um)} µm")
    return cells
