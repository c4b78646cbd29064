"""Reliefs with colour bar in µm, scale bar and title, and contact sheets of many reliefs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from device.surface import HeightMap, MaskArray
from host_sync.render.shading import (
    Picture,
    exaggeration_for,
    height_range_um,
    reduced,
    relief_rgb,
    steep_slope,
    tint_table,
)

MAX_COLUMNS: Final = 1600
MIN_COLUMNS: Final = 320
"""Reliefs with fewer columns are enlarged by an integer factor, to leave room for the lettering."""

_INK: Final = (40, 40, 40)
_STEPS: Final = (1.0, 2.0, 5.0)


class ReliefSheet:
    """Draws reliefs of one size onto one sheet.

    Parameters
    ----------
    shape : (H, W) of the height maps
    pitch_um : their pixel pitch, µm
    range_um : heights of the first and last colour, µm
    exaggeration : factor on the slopes for shading
    title : line above the relief
    footer : line below the scale bar; none when empty
    """

    def __init__(
        self,
        shape: tuple[int, int],
        pitch_um: float,
        range_um: tuple[float, float],
        exaggeration: float = 1.0,
        title: str = "",
        footer: str = "",
    ) -> None:
        self._footer = footer
        self._range_um = range_um
        self._exaggeration = exaggeration
        self._enlargement = max(1, -(-MIN_COLUMNS // shape[1]))
        self._rows, self._columns = (side * self._enlargement for side in shape)
        self._letter = max(13, round(float(np.sqrt(self._rows * self._columns)) / 50.0))
        self._font = ImageFont.truetype(font_file(), self._letter)
        self._edge = self._letter
        self._top = 2 * self._letter + self._edge // 2
        self._blank = self._draw_sheet(pitch_um / self._enlargement, title)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the sheet, both even, as movies require."""
        return self._blank.shape[0], self._blank.shape[1]

    def draw(self, height: HeightMap, caption: str = "", hatched: MaskArray | None = None) -> Picture:
        """Return the sheet with this relief: uint8 array of shape (H, W, 3), R, G, B.

        caption : a short text at the right end of the title line
        hatched : bool array of shape (H, W), pixels under slanting lines
        """
        sheet = self._blank.copy()
        relief = self._enlarged(relief_rgb(height, *self._range_um, self._exaggeration))
        if hatched is not None:
            # A white line beside a dark one shows on every tint.
            for shift, colour in ((0, _INK), (1, (255, 255, 255))):
                relief[self._enlarged(hatched) & self._lines(shift)] = colour
        sheet[self._top : self._top + self._rows, self._edge : self._edge + self._columns] = relief
        return self._lettered(sheet, caption) if caption else sheet

    def _enlarged(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return a copy with each pixel as often as the sheet shows it."""
        return plane.repeat(self._enlargement, axis=0).repeat(self._enlargement, axis=1)

    def _lines(self, shift: int) -> MaskArray:
        """Slanting lines over the relief, so many of their widths to the side."""
        row, column = np.ogrid[: self._rows, : self._columns]
        step = max(8, self._letter // 2)
        wide = max(1, step // 8)
        return np.asarray((row + column) % step // wide == shift)

    def _lettered(self, sheet: Picture, caption: str) -> Picture:
        line = Image.fromarray(sheet[: self._top])
        at = (self._edge + self._columns, self._top - self._letter // 2)
        ImageDraw.Draw(line).text(at, caption, fill=_INK, font=self._font, anchor="rs")
        sheet[: self._top] = np.asarray(line)
        return sheet

    def _draw_sheet(self, pitch_um: float, title: str) -> Picture:
        """Return the sheet without a relief."""
        most = max(2, self._rows // (2 * self._letter))
        labels = [(value, f"{value:g}") for value in ticks(*self._range_um, most)]
        bar = self._letter
        widest = max((self._font.getlength(text) for _, text in labels), default=0.0)
        right = bar + self._letter + int(max(widest, self._font.getlength("µm"))) + self._edge
        below = (4 if self._footer else 2) * self._letter + self._edge
        columns = self._edge + self._columns + self._edge + right
        rows = self._top + self._rows + below
        image = Image.new("RGB", (columns + columns % 2, rows + rows % 2), "white")
        draw = ImageDraw.Draw(image)
        line = shortened(title, self._font, self._columns * 0.7)
        draw.text((self._edge, self._top - self._letter // 2), line, _INK, self._font, "ls")
        self._draw_colour_bar(image, labels, bar)
        self._draw_scale_bar(draw, pitch_um)
        if self._footer:
            at = (self._edge, self._top + self._rows + self._edge + 2 * self._letter)
            draw.text(at, shortened(self._footer, self._font, columns - 2 * self._edge), _INK, self._font, "lm")
        return np.array(image)

    def _draw_colour_bar(self, image: Image.Image, labels: list[tuple[float, str]], width: int) -> None:
        left, top, bottom = 2 * self._edge + self._columns, self._top, self._top + self._rows
        colours = tint_table(self._rows)[::-1].astype(np.uint8)
        image.paste(Image.fromarray(np.repeat(colours[:, None], width, axis=1)), (left, top))
        draw = ImageDraw.Draw(image)
        low, high = self._range_um
        for value, text in labels:
            row = bottom - 1 - round((value - low) / max(high - low, 1e-9) * (self._rows - 1))
            draw.line((left + width, row, left + width + self._letter // 3, row), fill=_INK)
            draw.text((left + width + self._letter // 2, row), text, _INK, self._font, "lm")
        draw.text((left, top - self._letter // 2), "µm", _INK, self._font, "ls")

    def _draw_scale_bar(self, draw: ImageDraw.ImageDraw, pitch_um: float) -> None:
        """A bar of a round length, about a fifth of the relief, and the exaggeration of the shading."""
        length_um = round_below(0.25 * self._columns * pitch_um)
        text = f"{length_um / 1000.0:g} mm" if length_um >= 1000.0 else f"{length_um:g} µm"
        row, left = self._top + self._rows + self._edge, self._edge
        right = left + round(length_um / pitch_um)
        draw.rectangle((left, row - 2, right, row + 1), fill=_INK)
        draw.text((right + self._letter // 2, row), text, _INK, self._font, "lm")
        if self._exaggeration != 1.0:
            words = f"shading ×{self._exaggeration:g}"
            draw.text((self._edge + self._columns, row), words, _INK, self._font, "rm")


def shortened(text: str, font: ImageFont.FreeTypeFont, room_px: float) -> str:
    """Return the printable characters of a text, cut with an ellipsis to a width in pixels."""
    text = "".join(letter for letter in text if letter.isprintable())
    if font.getlength(text) <= room_px:
        return text
    while text and font.getlength(f"{text}…") > room_px:
        text = text[:-1]
    return f"{text}…"


def write_relief(
    path: Path, height: HeightMap, title: str, footer: str = "", extrapolated: MaskArray | None = None
) -> None:
    """Write the relief of a height map as a PNG.

    footer : line below it, such as what is zero
    extrapolated : pixels that are hatched, and whose heights the colours need not span

    Raises
    ------
    OSError
        The file cannot be written.
    """
    small = reduced(height, MAX_COLUMNS)
    exaggeration = exaggeration_for(steep_slope(small))
    hatched, shown = None, small
    if extrapolated is not None and extrapolated.any():
        rows, columns = small.z_um.shape
        hatched = cv2.resize(extrapolated.astype(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST) > 0
        measured = np.where(hatched, np.float32(np.nan), small.z_um)
        if np.isfinite(measured).any():
            shown = replace(small, z_um=measured)
    sheet = ReliefSheet(small.z_um.shape, small.pitch_um, height_range_um(shown), exaggeration, title, footer)
    write_picture(path, sheet.draw(small, hatched=hatched))


def write_picture(path: Path, picture: Picture) -> None:
    """Write a picture of shape (H, W, 3) as a PNG with light compression, which is faster.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    _, data = cv2.imencode(".png", picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 2])
    path.write_bytes(data.tobytes())


def round_below(value: float) -> float:
    """Return the largest number 1, 2 or 5 times a power of ten that does not exceed a positive value."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(max(step * decade for step in _STEPS if step * decade <= value * (1.0 + 1e-9)))


def ticks(low: float, high: float, most: int = 10) -> list[float]:
    """Round values from low to high, at most `most` and at most ten; ends have a tolerance of 1 %."""
    span = max(high - low, 1e-9)
    step = round_below(span / 3.0)
    while span / step > min(most, 10) - 1:
        step = round_below(2.6 * step)
    beside = 0.01 * span
    first, last = int(np.ceil((low - beside) / step)), int(np.floor((high + beside) / step))
    return [float(round(index * step, 12)) for index in range(first, last + 1)]


def font_file() -> str:
    """Return a font with µ, × and °, from matplotlib's data, without loading matplotlib itself.

    Raises
    ------
    ModuleNotFoundError
        matplotlib is not installed.
    """
    package = find_spec("matplotlib")
    if package is None or package.origin is None:
        raise ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib")
    return str(Path(package.origin).with_name("mpl-data") / "fonts" / "ttf" / "DejaVuSans.ttf")


STRIP_ROWS: Final = 56
_STRIP_LETTER: Final = 15
_BAR_ROWS: Final = 12
_MOST_COLUMNS: Final = 640
_LABEL_COLUMNS: Final = 70


def colour_strip(columns: int, range_um: tuple[float, float]) -> Picture:
    """Return the strip: uint8 array of shape (STRIP_ROWS, columns, 3).

    range_um : heights of the first and last colour, µm
    """
    font = ImageFont.truetype(font_file(), _STRIP_LETTER)
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
    """Return a picture of shape (H, W, 3) above its colour bar."""
    return np.concatenate([picture, colour_strip(picture.shape[1], range_um)])


CELL_PX: Final = 420
_GAP: Final = 20
_CELL_LETTER: Final = 17


def contact_sheet(
    pictures: Iterable[tuple[str, str, Picture]], across: int, range_um: tuple[float, float] | None = None
) -> Picture:
    """Return the picture of shape (H, W, 3) with `across` reliefs per row, each with its name and a line of facts.

    pictures : name, facts and picture of each, at most `CELL_PX` wide and high
    range_um : heights of the first and last colour of all, µm, for a colour bar below; None draws none
    """
    font = ImageFont.truetype(font_file(), _CELL_LETTER)
    lines: list[Image.Image] = []
    cells = list(pictures)
    below = 3 * _CELL_LETTER + _GAP
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
                at = (left, _GAP // 2 + tallest + 6 + number * round(1.35 * _CELL_LETTER))
                draw.text(at, shortened(words, font, CELL_PX), _INK if number == 0 else (110, 110, 110), font)
        lines.append(line)
    sheet = np.concatenate([np.asarray(line) for line in lines])
    return sheet if range_um is None else with_strip(sheet, range_um)
