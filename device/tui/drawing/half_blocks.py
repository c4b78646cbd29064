"""Two pixels per cell: the upper and the lower half of a block, each with its own brightness or colour.

A plain console has sixteen colours, four of them grey, and only the first eight as background; so brightness is
dithered to four greys, and the glyph draws the half that needs a bright grey. Without colour a cell has one of five
shades.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, MaskArray
from device.tui.drawing.cells import BLACK, GREY, OWN, SILVER, WHITE, CellGrid, ColourDepth

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
    """Cells of a grey picture.

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
    """Cells of a colour picture, 0xRRGGBB of shape (2 rows, columns); cells with an invalid half are hatched."""
    cells = CellGrid.empty(colour.shape[0] // 2, colour.shape[1], "full")
    cells.glyphs[:] = UPPER
    cells.ink[:], cells.paper[:] = colour[0::2], colour[1::2]
    return _hatched(cells, valid, _HATCH_INK)


def _dithered(brightness: Float32Array, levels: int) -> NDArray[np.int32]:
    """Brightness quantized to `levels`, with ordered dithering over 4 x 4 pixels."""
    rows, columns = brightness.shape
    threshold = np.tile(0.5 + _SPREAD * ((_BAYER + 0.5) / 16.0 - 0.5), (rows // 4 + 1, columns // 4 + 1))[
        :rows, :columns
    ]
    scaled = np.clip(np.nan_to_num(brightness), 0.0, 1.0) * np.float32(levels - 1)
    return np.asarray(np.minimum(np.floor(scaled + threshold), levels - 1), np.int32)


def _four_greys(brightness: Float32Array, valid: MaskArray) -> CellGrid:
    """Cells in a console's four greys; bright greys (odd levels) only as ink."""
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
    """Cells without colour: five shades of ink, one per cell."""
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
