"""A height map as terminal cells: lit from the upper left, coloured by height where the terminal has colours.

Colours go from deep blue over green to sand with increasing brightness, so that they also read without colour.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, HeightMap, MaskArray
from device.tui.drawing.cells import HATCH, CellGrid, ColourDepth, colour_cells, grey_cells, resampled

MIN_SPAN_UM: Final = 4.0
"""Flatter maps are drawn with this range, so that noise does not look like relief."""

_LIGHT: Final = (-0.5, -0.5, 0.70711)
_SHOWN_SLOPE: Final = 0.6
_MAX_GAIN: Final = 12.0
_HEIGHT_PART: Final[dict[ColourDepth, float]] = {"sixteen": 0.6, "mono": 2.0}
"""Weight of height against light where there are no colours."""


_ANCHORS: Final = np.array(
    [(26, 34, 74), (36, 82, 120), (48, 132, 134), (112, 174, 124), (206, 198, 128), (252, 238, 208)], np.float32
)


@dataclass(frozen=True, slots=True)
class HeightRange:
    """Heights (µm) at the ends of the scale; 99 % of a map lie between them."""

    lowest_um: float
    highest_um: float

    @classmethod
    def of(cls, z_um: Float32Array) -> HeightRange:
        """Return the range of a map or profile; `MIN_SPAN_UM` around zero without a valid pixel."""
        z_um = z_um[np.isfinite(z_um)]
        low, high = np.percentile(z_um, (0.5, 99.5)) if z_um.size else (0.0, 0.0)
        lacking = max(MIN_SPAN_UM - (high - low), 0.0) / 2.0
        return cls(float(low) - lacking, float(high) + lacking)

    def fraction(self, z_um: Float32Array) -> Float32Array:
        """Return heights as fractions of the range, 0 to 1."""
        span = self.highest_um - self.lowest_um
        return np.asarray(np.clip((z_um - self.lowest_um) / span, 0.0, 1.0), np.float32)


def relief_cells(height: HeightMap, heights: HeightRange, shape: tuple[int, int], depth: ColourDepth) -> CellGrid:
    """Return cells of a map, `shape` (rows, columns) of them; invalid ones are hatched."""
    z_um = resampled(height.z_um, (2 * shape[0], shape[1]))
    valid = np.isfinite(z_um)
    pitch_um = height.pitch_um * height.z_um.shape[1] / shape[1]
    light = lit(z_um, pitch_um)
    fraction = heights.fraction(z_um)
    if depth == "full":
        return colour_cells(height_colours(fraction, 0.35 + 0.9 * light), valid)
    return grey_cells(_stretched(_HEIGHT_PART[depth] * fraction + light, valid), valid, depth)


def _stretched(brightness: Float32Array, valid: MaskArray) -> Float32Array:
    """Return the brightness stretched from 0 to 1 over 96 % of the valid pixels, to use all of the few greys."""
    low, high = np.percentile(brightness[valid], (2, 98)) if valid.any() else (0.0, 1.0)
    return np.asarray((brightness - low) / max(high - low, 0.1), np.float32)


def lit(z_um: Float32Array, pitch_um: float) -> Float32Array:
    """Return diffuse light from the upper left, 0 to 1, 0.71 where flat; slopes are exaggerated to be visible."""
    q, p = np.gradient(z_um / np.float32(pitch_um)) if min(z_um.shape) > 1 else (z_um * 0.0, z_um * 0.0)
    p, q = np.nan_to_num(p), np.nan_to_num(q)
    steep = float(np.percentile(np.hypot(p, q), 95))
    gain = min(_SHOWN_SLOPE / max(steep, 1e-6), _MAX_GAIN)
    p, q = gain * p, gain * q
    cosine = (-p * _LIGHT[0] - q * _LIGHT[1] + _LIGHT[2]) / np.sqrt(1.0 + p * p + q * q)
    return np.asarray(np.clip(cosine, 0.0, 1.0), np.float32)


def height_colours(fraction: Float32Array, shade: Float32Array) -> NDArray[np.int32]:
    """Return colours as 0xRRGGBB.

    Parameters
    ----------
    fraction : float32 array, height from 0 (lowest) to 1 (highest); NaN counts as 0
    shade : float32 array of the same shape, factor on the colour's brightness
    """
    place = np.clip(np.nan_to_num(fraction), 0.0, 1.0) * (len(_ANCHORS) - 1)
    below = np.minimum(place.astype(np.int32), len(_ANCHORS) - 2)
    within = (place - below)[..., np.newaxis]
    colour = (_ANCHORS[below] * (1.0 - within) + _ANCHORS[below + 1] * within) * shade[..., np.newaxis]
    red, green, blue = np.moveaxis(np.clip(colour + 0.5, 0.0, 255.0).astype(np.int32), -1, 0)
    return np.asarray((red << 16) | (green << 8) | blue, np.int32)


# The height scale beside a relief, in µm, the length bar below it, and round numbers for both.

BAR_COLUMNS: Final = 2
LEGEND_COLUMNS: Final = 9
"""A blank, two columns of bar, a blank, and up to five digits."""


def legend_cells(heights: HeightRange, rows: int, depth: ColourDepth) -> CellGrid:
    """Return a bar of all heights, highest on top, with round numbers and the unit above."""
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
    """Return a bar of a round length with its label, such as "├───┤ 2 mm"; empty in few columns.

    pitch_um : distance of neighbouring columns
    """
    if columns < 16:
        return ""
    length_um = round_down(pitch_um * columns / 3.0)
    dashes = max(round(length_um / pitch_um) - 2, 0)
    return f"├{'─' * dashes}┤ {length_text(length_um)}"


def round_step(span: float, max_parts: int) -> float:
    """Return the smallest step of 1, 2 or 5 times a power of ten that divides `span` into at most `max_parts` parts."""
    least = span / max(max_parts, 1)
    power = 10.0 ** math.floor(math.log10(least))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least * (1.0 - 1e-9))


def round_down(limit: float) -> float:
    """Return the largest of 1, 2 or 5 times a power of ten that does not exceed `limit`."""
    power = 10.0 ** math.floor(math.log10(limit) + 1e-9)
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= limit * (1.0 + 1e-9))


def ticks(lowest: float, highest: float, max_parts: int) -> list[float]:
    """Return multiples of a round step from lowest to highest, at most `max_parts` + 1."""
    step = round_step(highest - lowest, max_parts)
    first, last = math.ceil(lowest / step - 1e-9), math.floor(highest / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def height_text(z_um: float) -> str:
    """Return a height as the scale shows it, without unit: tenths below 10 µm, otherwise whole µm."""
    text = f"{z_um:.1f}" if abs(z_um) < 9.95 and z_um != round(z_um) else f"{z_um:.0f}"
    return "0" if text in {"-0", "-0.0"} else text


def length_text(length_um: float) -> str:
    """Return a length on the skin in a suitable unit, such as "2 mm" or "500 µm"."""
    return f"{length_um / 1e3:g} mm" if length_um >= 1e3 else f"{length_um:g} µm"


# The profile along a row or column of a height map, drawn as bars with a scale in µm.

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
        """Return the cursor moved by these fractions of the map, kept on it."""
        return ProfileCursor(self.axis, _within(self.line + across), _within(self.point + along))

    def turned(self) -> ProfileCursor:
        """Return the line through the same point in the other direction."""
        return ProfileCursor("column" if self.axis == "row" else "row", self.point, self.line)


def _within(fraction: float) -> float:
    return min(max(fraction, 0.0), 1.0)


def profile_um(height: HeightMap, cursor: ProfileCursor) -> Float32Array:
    """Return heights along the cursor's line: float32 array of shape (n,), µm, NaN where invalid."""
    across = height.z_um if cursor.axis == "row" else height.z_um.T
    return np.asarray(across[round(cursor.line * (len(across) - 1))], np.float32)


def reading(height: HeightMap, cursor: ProfileCursor, origin: tuple[int, int] = (0, 0)) -> str:
    """Return the position and height at the cursor's point, such as "x 3.20 mm  y 6.10 mm  z 41.5 µm".

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
    """Return a profile as `columns` bars above its lowest height.

    Its range in µm stands at the right, its point below.

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
