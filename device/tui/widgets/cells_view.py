"""The base of widgets that draw a grid of cells."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from rich.color import Color, ColorType
from rich.segment import Segment
from rich.style import Style
from textual.events import Resize
from textual.geometry import Region
from textual.strip import Strip
from textual.widget import Widget

from device.tui.drawing.cells import OWN, CellGrid, ColourDepth
from device.tui.drawing.height_picture import Room


class CellsView(Widget):
    """A widget whose content is a cell grid; subclasses draw it.

    Parameters
    ----------
    depth : the terminal's colours
    below : rows to keep free below the picture
    """

    def __init__(self, depth: ColourDepth, below: int = 0, *, id: str | None = None) -> None:  # noqa: A002
        super().__init__(id=id)
        self._below = below
        self._depth: ColourDepth = depth
        self._lines: list[Strip] | None = None
        self._cells: CellGrid | None = None

    def draw(self, room: Room) -> CellGrid:
        """The widget's cells, which fill the room."""
        raise NotImplementedError

    def on_resize(self, _event: Resize) -> None:
        """Draw again at the new size."""
        self._lines = None

    def render_line(self, y: int) -> Strip:
        """A row of the picture."""
        if self._lines is None:
            self._cells = self.draw(self.room(self.size.height, self.size.width))
            self._lines = to_strips(self._cells, self.rich_style)
        return self._lines[y] if y < len(self._lines) else Strip.blank(self.size.width, self.rich_style)

    def room(self, rows: int, columns: int) -> Room:
        """Cells for a picture, in the terminal's colours."""
        return Room(rows, columns, self._depth)

    def redraw_changes(self) -> None:
        """Draw again, and send the terminal only the cells that differ."""
        before = self._cells
        if self._lines is None or before is None:
            self.redraw(layout=False)
            return
        cells = self.draw(self.room(*before.shape))
        differ = (cells.glyphs != before.glyphs) | (cells.bold != before.bold)
        differ |= (cells.ink != before.ink) | (cells.paper != before.paper)
        self._cells, changed = cells, []
        for row in np.flatnonzero(differ.any(axis=1)):
            first, last = np.flatnonzero(differ[row])[[0, -1]].tolist()
            self._lines[row] = _strip(cells, int(row), self.rich_style)
            changed.append(Region(first, int(row), last - first + 1, 1))
        if changed:
            self.refresh(*changed)

    def redraw(self, layout: bool) -> None:
        """Draw again; `layout` if the picture's height may have changed."""
        self._lines = None
        self.refresh(layout=layout)


def to_strips(cells: CellGrid, base: Style) -> list[Strip]:
    """One strip per row, a segment per run of equal style; `base` shows where cells have default colours."""
    return [_strip(cells, row, base) for row in range(cells.shape[0])]


def _strip(cells: CellGrid, row: int, base: Style) -> Strip:
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
