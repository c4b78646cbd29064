"""A terminal's cells as a picture, drawn as by a terminal: block glyphs to the pixel, the rest from a font."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rich.segment import Segment
from rich.style import Style
from rich.terminal_theme import TerminalTheme

CELL: Final = (8, 16)
"""Columns and rows of pixels in a cell, as on the handheld's 800 x 480 panel."""

_FONT_SIZE: Final = 13
_BASELINE: Final = 12
_CONSOLE: Final = TerminalTheme(
    (0, 0, 0),
    (170, 170, 170),
    [(0, 0, 0), (170, 0, 0), (0, 170, 0), (170, 85, 0), (0, 0, 170), (170, 0, 170), (0, 170, 170), (170, 170, 170)],
    [
        (85, 85, 85), (255, 85, 85), (85, 255, 85), (255, 255, 85),
        (85, 85, 255), (255, 85, 255), (85, 255, 255), (255, 255, 255),
    ],
)  # fmt: skip
"""The sixteen colours of the Linux console."""

Box = tuple[float, float, float, float]
_EIGHTHS: Final[dict[str, Box]] = {
    glyph: (0, 1 - (number + 1) / 8, 1, 1) for number, glyph in enumerate("▁▂▃▄▅▆▇█")
} | {"▀": (0, 0, 1, 0.5), "▌": (0, 0, 0.5, 1), "▐": (0.5, 0, 1, 1)}


def terminal_picture(lines: Sequence[Iterable[Segment]], columns: int) -> Image.Image:
    """Picture of a screen given as rows of styled segments."""
    width, height = CELL
    picture = Image.new("RGB", (columns * width, len(lines) * height), _CONSOLE.background_color)
    draw = ImageDraw.Draw(picture)
    fonts = {bold: _font(bold) for bold in (False, True)}
    for row, line in enumerate(lines):
        column = 0
        for segment in line:
            ink, paper = _colours(segment.style or Style())
            font = fonts[bool(segment.style and segment.style.bold)]
            for glyph in segment.text:
                _draw_cell(draw, (column * width, row * height), glyph, ink, paper, font)
                column += 1
            if segment.style and segment.style.underline:
                bottom = row * height + height - 2
                draw.line([((column - len(segment.text)) * width, bottom), (column * width - 1, bottom)], ink)
    return picture


def _draw_cell(
    draw: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    glyph: str,
    ink: tuple[int, int, int],
    paper: tuple[int, int, int],
    font: ImageFont.FreeTypeFont,
) -> None:
    (left, top), (width, height) = corner, CELL
    draw.rectangle((left, top, left + width - 1, top + height - 1), paper)
    if glyph in _EIGHTHS:
        x0, y0, x1, y1 = _EIGHTHS[glyph]
        box = (left + x0 * width, top + round(y0 * height), left + x1 * width - 1, top + round(y1 * height) - 1)
        draw.rectangle(box, ink)
    elif glyph in "░▒▓":
        shade = 0.25 * ("░▒▓".index(glyph) + 1)
        mixed = np.asarray(paper) * (1 - shade) + np.asarray(ink) * shade
        draw.rectangle((left, top, left + width - 1, top + height - 1), tuple(int(part) for part in mixed))
    elif glyph != " ":
        draw.text((left, top + _BASELINE), glyph, ink, font, anchor="ls")


def _colours(style: Style) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    """Foreground and background of a style, reversed and dimmed as by a terminal."""
    ink = tuple(style.color.get_truecolor(_CONSOLE)) if style.color else _CONSOLE.foreground_color
    paper = (
        tuple(style.bgcolor.get_truecolor(_CONSOLE, foreground=False)) if style.bgcolor else _CONSOLE.background_color
    )
    if style.reverse:
        ink, paper = paper, ink
    if style.dim:
        ink = tuple((a + b) // 2 for a, b in zip(ink, paper, strict=True))
    return ink, paper  # type: ignore[return-value]


def _font(bold: bool) -> ImageFont.FreeTypeFont:
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(folder / f"DejaVuSansMono{'-Bold' if bold else ''}.ttf", _FONT_SIZE)
