"""The height scale beside a relief, in µm, the length bar below it, and round numbers for both."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from device.surface.fields import Float32Array
from device.tui.drawing.cells import CellGrid, ColourDepth
from device.tui.drawing.half_blocks import colour_cells, grey_cells
from device.tui.drawing.relief import HeightRange, height_colours

BAR_COLUMNS: Final = 2
LEGEND_COLUMNS: Final = 9
"""A blank, two columns of bar, a blank, and up to five digits."""


def legend_cells(heights: HeightRange, rows: int, depth: ColourDepth) -> CellGrid:
    """A bar of all heights, highest on top, with round numbers and the unit above."""
    cells = CellGrid.empty(rows, LEGEND_COLUMNS, depth)
    if rows < 3:
        return cells
    cells.write(0, 1, "µm")
    bar_rows = rows - 1
    fraction = np.repeat(np.linspace(1.0, 0.0, 2 * bar_rows, dtype=np.float32)[:, np.newaxis], BAR_COLUMNS, axis=1)
    cells.blit(1, 1, _bar(fraction, depth))
    for z_um in ticks(heights.lowest_um, heights.highest_um, max(bar_rows // 2, 2)):
        up = (z_um - heights.lowest_um) / (heights.highest_um - heights.lowest_um)
        cells.write(1 + min(int((1.0 - up) * bar_rows), bar_rows - 1), 2 + BAR_COLUMNS, height_text(z_um))
    return cells


def _bar(fraction: Float32Array, depth: ColourDepth) -> CellGrid:
    valid = np.ones(fraction.shape, np.bool_)
    if depth == "full":
        return colour_cells(height_colours(fraction, np.ones_like(fraction)), valid)
    return grey_cells(fraction, valid, depth)


def length_bar(pitch_um: float, columns: int) -> str:
    """A bar of a round length with its label, such as "├───┤ 2 mm"; `pitch_um` is the distance of the columns."""
    if columns < 16:
        return ""
    length_um = round_down(pitch_um * columns / 3.0)
    dashes = max(round(length_um / pitch_um) - 2, 0)
    return f"├{'─' * dashes}┤ {length_text(length_um)}"


def round_step(span: float, max_parts: int) -> float:
    """The smallest step of 1, 2 or 5 times a power of ten that divides `span` into at most `max_parts` parts."""
    least = span / max(max_parts, 1)
    power = 10.0 ** math.floor(math.log10(least))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least * (1.0 - 1e-9))


def round_down(limit: float) -> float:
    """The largest of 1, 2 or 5 times a power of ten that does not exceed `limit`."""
    power = 10.0 ** math.floor(math.log10(limit) + 1e-9)
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= limit * (1.0 + 1e-9))


def ticks(lowest: float, highest: float, max_parts: int) -> list[float]:
    """Multiples of a round step from lowest to highest, at most `max_parts` + 1."""
    step = round_step(highest - lowest, max_parts)
    first, last = math.ceil(lowest / step - 1e-9), math.floor(highest / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def height_text(z_um: float) -> str:
    """A height as the scale shows it, without unit: tenths below 10 µm, otherwise whole µm."""
    text = f"{z_um:.1f}" if abs(z_um) < 9.95 and z_um != round(z_um) else f"{z_um:.0f}"
    return "0" if text in {"-0", "-0.0"} else text


def length_text(length_um: float) -> str:
    """A length on the skin in a suitable unit, such as "2 mm" or "500 µm"."""
    return f"{length_um / 1e3:g} mm" if length_um >= 1e3 else f"{length_um:g} µm"
