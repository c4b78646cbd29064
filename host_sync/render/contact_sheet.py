"""Contact sheet: many reliefs with their names on one picture."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from host_sync.render.colour_strip import with_strip
from host_sync.render.relief import Picture
from host_sync.render.relief_sheet import font_file, shortened

CELL_PX: Final = 420
_GAP: Final = 20
_LETTER: Final = 17
_INK: Final = (40, 40, 40)


def contact_sheet(
    pictures: Iterable[tuple[str, str, Picture]], across: int, range_um: tuple[float, float] | None = None
) -> Picture:
    """Picture of shape (H, W, 3) with `across` reliefs per row, each with its name and a line of facts.

    pictures : name, facts and picture of each, at most `CELL_PX` wide and high
    range_um : heights of the first and last colour of all, µm, for a colour bar below; None draws none
    """
    font = ImageFont.truetype(font_file(), _LETTER)
    lines: list[Image.Image] = []
    cells = list(pictures)
    below = 3 * _LETTER + _GAP
    across = max(1, min(across, len(cells)))
    width = across * (CELL_PX + _GAP) + _GAP
    for first in range(0, len(cells), across):
        some = cells[first : first + across]
        tallest = max(picture.shape[0] for _, _, picture in some)
        line = Image.new("RGB", (width, tallest + below + _GAP // 2), "white")
        draw = ImageDraw.Draw(line)
        for index, (name, facts, picture) in enumerate(some):
            left = _GAP + index * (CELL_PX + _GAP)
            line.paste(Image.fromarray(picture), (left + (CELL_PX - picture.shape[1]) // 2, _GAP // 2))
            for number, words in enumerate((name, facts)):
                at = (left, _GAP // 2 + tallest + 6 + number * round(1.35 * _LETTER))
                draw.text(at, shortened(words, font, CELL_PX), _INK if number == 0 else (110, 110, 110), font)
        lines.append(line)
    sheet = np.concatenate([np.asarray(line) for line in lines])
    return sheet if range_um is None else with_strip(sheet, range_um)
