"""A grid of terminal cells, into which every picture is drawn, and the colours that a terminal has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, MaskArray

OWN: Final = -1
"""The terminal's default colour."""

BLACK, SILVER, GREY, WHITE = 0, 7, 8, 15
"""Numbers of the four greys among a console's sixteen colours."""


ColourDepth = Literal["full", "sixteen", "mono"]
"""Any colour, the sixteen of a plain console, or none."""

_MONO: Final = ("", "dumb", "unknown", "vt100", "vt102", "vt220")


@dataclass(frozen=True, slots=True, eq=False)
class CellGrid:
    """Glyphs and their colours, drawn in place.

    glyphs : '<U1' array of shape (rows, columns)
    ink, paper : int32 arrays of the same shape; 0xRRGGBB in full colour, 0 to 15 in sixteen, `OWN` for the default
    bold : bool array of the same shape
    depth : which colours are meant
    """

    glyphs: NDArray[np.str_]
    ink: NDArray[np.int32]
    paper: NDArray[np.int32]
    bold: NDArray[np.bool_]
    depth: ColourDepth

    @classmethod
    def empty(cls, rows: int, columns: int, depth: ColourDepth) -> CellGrid:
        """Return a grid of spaces in the terminal's default colours."""
        shape = (max(rows, 0), max(columns, 0))
        own = np.full(shape, OWN, np.int32)
        return cls(np.full(shape, " ", "<U1"), own, own.copy(), np.zeros(shape, np.bool_), depth)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        rows, columns = self.glyphs.shape
        return rows, columns

    def write(self, row: int, column: int, text: str, bold: bool = False) -> None:
        """Write text on a row in the default colours; it is clipped to the grid."""
        rows, columns = self.shape
        if not 0 <= row < rows:
            return
        for place, glyph in enumerate(text, start=column):
            if 0 <= place < columns:
                self.glyphs[row, place] = glyph
                self.ink[row, place] = self.paper[row, place] = OWN
                self.bold[row, place] = bold

    def blit(self, row: int, column: int, part: CellGrid) -> None:
        """Copy another grid here; it is clipped to this one."""
        rows, columns = (min(size, room) for size, room in zip(part.shape, self._room(row, column), strict=True))
        here = np.s_[row : row + rows, column : column + columns]
        there = np.s_[:rows, :columns]
        self.glyphs[here], self.ink[here] = part.glyphs[there], part.ink[there]
        self.paper[here], self.bold[here] = part.paper[there], part.bold[there]

    def lines(self) -> list[str]:
        """Return the glyphs of each row."""
        return ["".join(row) for row in self.glyphs]

    def _room(self, row: int, column: int) -> tuple[int, int]:
        rows, columns = self.shape
        return max(rows - row, 0), max(columns - column, 0)


def colour_depth(environment: Mapping[str, str]) -> ColourDepth:
    """Return the colours of a terminal, from its environment variables: none with NO_COLOR, sixteen by default."""
    term = environment.get("TERM", "")
    if environment.get("NO_COLOR") or term in _MONO:
        return "mono"
    promised = environment.get("COLORTERM", "").lower() in {"truecolor", "24bit"}
    return "full" if promised or term.endswith("256color") or "kitty" in term else "sixteen"


# Two pixels per cell: the upper and the lower half of a block, each with its own brightness or colour.
#
# A plain console has sixteen colours, four of them grey, and only the first eight as background; so brightness is
# dithered to four greys, and the glyph draws the half that needs a bright grey. Without colour a cell has one of five
# shades.

UPPER, LOWER, FULL = "▀", "▄", "█"
SHADES: Final = " ░▒▓█"
HATCH: Final = "/"
"""Hatch for invalid pixels; no height looks like it."""

_HATCH_INK: Final = 0x55606C
_BAYER: Final = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]], np.float32)
_SPREAD: Final = 0.5
"""Dither amplitude as a fraction of the level distance; below 1 it leaves uniform areas uniform."""

_GREYS: Final = np.array([BLACK, GREY, SILVER, WHITE], np.int32)


def grey_cells(brightness: Float32Array, valid: MaskArray, depth: ColourDepth) -> CellGrid:
    """Return cells of a grey picture.

    Parameters
    ----------
    brightness : float32 array of shape (2 rows, columns), 0 (black) to 1 (white)
    valid : bool array of the same shape; a cell with an invalid half is hatched
    """
    if depth == "full":
        level = np.clip(brightness * 31.0 + 0.5, 0.0, 31.0).astype(np.int32) * 255 // 31
        return colour_cells(level * 0x010101, valid)
    return _four_greys(brightness, valid) if depth == "sixteen" else _shades(brightness, valid)


def colour_cells(colour: NDArray[np.int32], valid: MaskArray) -> CellGrid:
    """Return cells of a colour picture, 0xRRGGBB of shape (2 rows, columns); cells with an invalid half are hatched."""
    cells = CellGrid.empty(colour.shape[0] // 2, colour.shape[1], "full")
    cells.glyphs[:] = UPPER
    cells.ink[:], cells.paper[:] = colour[0::2], colour[1::2]
    return _hatched(cells, valid, _HATCH_INK)


def _dithered(brightness: Float32Array, levels: int) -> NDArray[np.int32]:
    """Return the brightness quantized to `levels`, with ordered dithering over 4 x 4 pixels."""
    rows, columns = brightness.shape
    threshold = np.tile(0.5 + _SPREAD * ((_BAYER + 0.5) / 16.0 - 0.5), (rows // 4 + 1, columns // 4 + 1))[
        :rows, :columns
    ]
    scaled = np.clip(np.nan_to_num(brightness), 0.0, 1.0) * np.float32(levels - 1)
    return np.asarray(np.minimum(np.floor(scaled + threshold), levels - 1), np.int32)


def _four_greys(brightness: Float32Array, valid: MaskArray) -> CellGrid:
    """Return cells in a console's four greys; bright greys (odd levels) only as ink."""
    levels = _dithered(brightness, len(_GREYS))
    upper, lower = levels[0::2], levels[1::2]
    cells = CellGrid.empty(upper.shape[0], upper.shape[1], "sixteen")
    both_bright = (upper % 2 == 1) & (lower % 2 == 1) & (upper != lower)
    upper = np.where(both_bright & (upper == 1), 0, upper)
    lower = np.where(both_bright & (lower == 1), 0, lower)
    lower_draws = lower % 2 == 1
    cells.glyphs[:] = np.where(upper == lower, FULL, np.where(lower_draws, LOWER, UPPER))
    cells.ink[:] = _GREYS[np.where(lower_draws, lower, upper)]
    cells.paper[:] = np.where(upper == lower, BLACK, _GREYS[np.where(lower_draws, upper, lower)])
    return _hatched(cells, valid, GREY)


def _shades(brightness: Float32Array, valid: MaskArray) -> CellGrid:
    """Return cells without colour: five shades of ink, one per cell."""
    mean = (brightness[0::2] + brightness[1::2]) / np.float32(2.0)
    cells = CellGrid.empty(mean.shape[0], mean.shape[1], "mono")
    shade = np.clip(np.nan_to_num(mean) * len(SHADES), 0, len(SHADES) - 1).astype(np.int32)
    cells.glyphs[:] = np.array(list(SHADES))[shade]
    return _hatched(cells, valid, OWN)


def _hatched(cells: CellGrid, valid: MaskArray, ink: int) -> CellGrid:
    outside = ~(valid[0::2] & valid[1::2])
    cells.glyphs[outside] = HATCH
    cells.ink[outside], cells.paper[outside] = ink, OWN
    return cells


# Maps and pictures resampled to a terminal's pixels: means over the valid pixels of each area.

MIN_VALID: Final = 0.5
"""Minimum valid fraction of an area for a valid mean."""


def fitted_shape(shape: tuple[int, ...], rows: int, columns: int) -> tuple[int, int]:
    """Return the largest (rows, columns) of cells in which a picture of `shape` (H, W) keeps its proportions.

    A cell is twice as high as wide and holds two square pixels.
    """
    height, width = shape
    scale = min(2.0 * rows / height, columns / width)
    return max(min(round(height * scale / 2.0), rows), 1), max(min(round(width * scale), columns), 1)


def resampled(values: Float32Array, shape: tuple[int, int]) -> Float32Array:
    """Return a map on another grid: float32 array of `shape` (h, w), NaN where too little was valid."""
    valid = np.isfinite(values)
    size = (shape[1], shape[0])
    method = cv2.INTER_AREA if shape[0] <= values.shape[0] else cv2.INTER_LINEAR
    fraction = cv2.resize(valid.astype(np.float32), size, interpolation=method)
    total = cv2.resize(np.where(valid, values, np.float32(0.0)), size, interpolation=method)
    known = fraction >= MIN_VALID
    mean = np.full(shape, np.nan, np.float32)
    np.divide(total, fraction, out=mean, where=known)
    return mean
