"""Many reliefs on one sheet, each with its name."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from host_sync.render.relief import Picture

CELL_PX: Final = 420
_GAP: Final = 20
_LETTER: Final = 17
_INK: Final = (40, 40, 40)


def contact_sheet(pictures: Iterable[tuple[str, str, Picture]], across: int) -> Picture:
    """Sheet of shape (H, W, 3): name, a line of facts and picture of each, `across` side by side.

    pictures : are taken one at a time, at most `CELL_PX` wide and high
    """
    font = ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), _LETTER)
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
                draw.text(at, shortened(words, font), _INK if number == 0 else (110, 110, 110), font)
        lines.append(line)
    return np.concatenate([np.asarray(line) for line in lines])


def shortened(words: str, font: ImageFont.FreeTypeFont, room_px: float = CELL_PX) -> str:
    """The words, or their beginning when they are too long; control characters are left out."""
    text = "".join(letter for letter in words if letter.isprintable())
    if font.getlength(text) <= room_px:
        return text
    while text and font.getlength(f"{text}…") > room_px:
        text = text[:-1]
    return f"{text}…"
