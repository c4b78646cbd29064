"""The profile along a row or column of a height map, and its drawing as columns of blocks with a scale in µm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from device.surface import Float32Array, HeightMap
from device.tui.cells import Cells
from device.tui.half_blocks import HATCH
from device.tui.relief import HeightRange
from device.tui.resampling import resampled
from device.tui.scale import height_text
from device.tui.terminal import ColourDepth

Axis = Literal["row", "column"]

LABEL_COLUMNS: Final = 9
"""A blank and up to eight glyphs, such as "-1234 µm"."""

_EIGHTHS: Final = " ▁▂▃▄▅▆▇█"
_HALVES: Final = " ▄█"
"""What the font of a plain console holds."""


@dataclass(frozen=True, slots=True)
class ProfileCursor:
    """A line across the map and a point on it.

    axis : along which the line runs
    line : where the line lies, as a share (0 to 1) across the map
    point : where the point lies, as a share (0 to 1) along the line
    """

    axis: Axis = "row"
    line: float = 0.5
    point: float = 0.5

    def moved(self, across: float, along: float) -> ProfileCursor:
        """The cursor moved by these shares, kept on the map."""
        return ProfileCursor(self.axis, _within(self.line + across), _within(self.point + along))

    def turned(self) -> ProfileCursor:
        """The line through the same point in the other direction."""
        return ProfileCursor("column" if self.axis == "row" else "row", self.point, self.line)


def _within(share: float) -> float:
    return min(max(share, 0.0), 1.0)


def profile_um(height: HeightMap, cursor: ProfileCursor) -> Float32Array:
    """Heights along the cursor's line, float32 array of shape (n,), µm, NaN where invalid."""
    across = height.z_um if cursor.axis == "row" else height.z_um.T
    return np.asarray(across[round(cursor.line * (len(across) - 1))], np.float32)


def reading(height: HeightMap, cursor: ProfileCursor) -> str:
    """The place and the height under the cursor's point, such as "x 3.20 mm  y 6.10 mm  z 41.5 µm"."""
    rows, columns = height.z_um.shape
    along_row = cursor.axis == "row"
    row = round((cursor.line if along_row else cursor.point) * (rows - 1))
    column = round((cursor.point if along_row else cursor.line) * (columns - 1))
    z_um = float(height.z_um[row, column])
    x_mm, y_mm = column * height.pitch_um / 1e3, row * height.pitch_um / 1e3
    return f"x {x_mm:.2f} mm  y {y_mm:.2f} mm  z {f'{z_um:.1f} µm' if np.isfinite(z_um) else 'not measured'}"


def profile_cells(profile: Float32Array, point: float, rows: int, columns: int, depth: ColourDepth) -> Cells:
    """A profile as `columns` bars that stand on its lowest height; its ends in µm at the right, its point marked below.

    profile : float32 array of shape (n,), µm
    point : where the cursor's point lies along it, 0 to 1
    """
    cells = Cells.blank(rows, columns + LABEL_COLUMNS, depth)
    blocks = _EIGHTHS if depth == "full" else _HALVES
    heights = HeightRange.of(profile)
    z_um = resampled(profile[np.newaxis, :], (1, columns))[0]
    bars, parts = rows - 1, len(blocks) - 1
    filled = np.clip(np.round(heights.share(np.nan_to_num(z_um)) * bars * parts), 1, bars * parts).astype(np.int32)
    for row in range(bars):
        level = np.clip(filled - (bars - 1 - row) * parts, 0, parts)
        cells.glyphs[row, :columns] = np.where(np.isfinite(z_um), np.array(list(blocks))[level], HATCH)
    cells.write(bars, round(point * (columns - 1)), "▲", bold=True)
    cells.write(0, columns + 1, f"{height_text(heights.highest_um)} µm")
    cells.write(bars - 1, columns + 1, f"{height_text(heights.lowest_um)} µm")
    return cells
