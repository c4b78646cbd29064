"""The scale of heights beside a relief, in µm, and the bar of length below it."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.surface import Float32Array
from device.tui.cells import Cells
from device.tui.colour_map import height_colours
from device.tui.half_blocks import colour_cells, grey_cells
from device.tui.relief import HeightRange
from device.tui.scale import height_text, length_text, round_down, ticks
from device.tui.terminal import ColourDepth

BAR_COLUMNS: Final = 2
LEGEND_COLUMNS: Final = 9
"""A blank, the bar, a blank, and up to five figures."""


def legend_cells(heights: HeightRange, rows: int, depth: ColourDepth) -> Cells:
    """A bar of every height, the highest on top, with round figures; the unit stands above it."""
    cells = Cells.blank(rows, LEGEND_COLUMNS, depth)
    if rows < 3:
        return cells
    cells.write(0, 1, "µm")
    bar_rows = rows - 1
    share = np.repeat(np.linspace(1.0, 0.0, 2 * bar_rows, dtype=np.float32)[:, np.newaxis], BAR_COLUMNS, axis=1)
    cells.paste(1, 1, _bar(share, depth))
    for z_um in ticks(heights.lowest_um, heights.highest_um, max(bar_rows // 2, 2)):
        share_up = (z_um - heights.lowest_um) / (heights.highest_um - heights.lowest_um)
        cells.write(1 + min(int((1.0 - share_up) * bar_rows), bar_rows - 1), 2 + BAR_COLUMNS, height_text(z_um))
    return cells


def _bar(share: Float32Array, depth: ColourDepth) -> Cells:
    valid = np.ones(share.shape, np.bool_)
    if depth == "full":
        return colour_cells(height_colours(share, np.ones_like(share)), valid)
    return grey_cells(share, valid, depth)


def length_bar(pitch_um: float, columns: int) -> str:
    """A bar of a round length with its words, such as "├───┤ 2 mm", for a relief whose columns are `pitch_um` apart."""
    if columns < 16:
        return ""
    length_um = round_down(pitch_um * columns / 3.0)
    dashes = max(round(length_um / pitch_um) - 2, 0)
    return f"├{'─' * dashes}┤ {length_text(length_um)}"
