"""Cells as textual draws them: runs of equal style become segments of a strip."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from rich.color import Color, ColorType
from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from device.tui.cells import OWN, Cells


def strips(cells: Cells, base: Style) -> list[Strip]:
    """One strip a row; `base` is the widget's own style, which shows where the terminal's own colours were asked."""
    return [_strip(cells, row, base) for row in range(cells.shape[0])]


def _strip(cells: Cells, row: int, base: Style) -> Strip:
    ink, paper, bold = cells.ink[row], cells.paper[row], cells.bold[row]
    changes = (np.diff(ink) != 0) | (np.diff(paper) != 0) | (np.diff(bold.astype(np.int8)) != 0)
    starts = [0, *(np.flatnonzero(changes) + 1).tolist(), len(ink)]
    text = "".join(cells.glyphs[row])
    full = cells.depth == "full"
    segments = [
        Segment(text[start:end], base + _style(int(ink[start]), int(paper[start]), bool(bold[start]), full))
        for start, end in pairwise(starts)
        if end > start
    ]
    return Strip(segments, len(ink))


@lru_cache(maxsize=4096)
def _style(ink: int, paper: int, bold: bool, full: bool) -> Style:
    return Style(color=_colour(ink, full), bgcolor=_colour(paper, full), bold=bold or None)


def _colour(colour: int, full: bool) -> Color | None:
    if colour == OWN:
        return None
    if full:
        return Color.from_rgb(colour >> 16, colour >> 8 & 255, colour & 255)
    return Color(f"color({colour})", ColorType.STANDARD, number=colour)
