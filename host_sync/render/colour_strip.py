"""A colour bar as a strip below pictures that share one range of heights."""

from __future__ import annotations

from typing import Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from host_sync.render.colormap import tint_table
from host_sync.render.relief import Picture
from host_sync.render.relief_sheet import font_file, ticks

STRIP_ROWS: Final = 56
_LETTER: Final = 15
_INK: Final = (40, 40, 40)
_BAR_ROWS: Final = 12
_MOST_COLUMNS: Final = 640
_LABEL_COLUMNS: Final = 70


def colour_strip(columns: int, range_um: tuple[float, float]) -> Picture:
    """The strip: uint8 array of shape (STRIP_ROWS, columns, 3).

    range_um : heights of the first and last colour, µm
    """
    font = ImageFont.truetype(font_file(), _LETTER)
    edge = min(40, columns // 8)
    width = max(16, min(columns - 2 * edge - int(font.getlength("  µm")), _MOST_COLUMNS))
    image = Image.new("RGB", (columns, STRIP_ROWS), "white")
    colours = tint_table(width).astype(np.uint8)
    image.paste(Image.fromarray(np.repeat(colours[None], _BAR_ROWS, axis=0)), (edge, 8))
    draw = ImageDraw.Draw(image)
    low, high = range_um
    for value in ticks(low, high, max(2, width // _LABEL_COLUMNS)):
        place = edge + round((value - low) / max(high - low, 1e-9) * (width - 1))
        draw.line((place, 8 + _BAR_ROWS, place, 12 + _BAR_ROWS), fill=_INK)
        draw.text((place, 14 + _BAR_ROWS), f"{value:g}", _INK, font, "ma")
    draw.text((edge + width + 6, 8 + _BAR_ROWS // 2), "µm", _INK, font, "lm")
    return np.array(image)


def with_strip(picture: Picture, range_um: tuple[float, float]) -> Picture:
    """A picture of shape (H, W, 3) above its colour bar."""
    return np.concatenate([picture, colour_strip(picture.shape[1], range_um)])
