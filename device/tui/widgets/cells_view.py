"""The base of widgets that draw a grid of cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from rich.color import Color, ColorType
from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.events import Click, Resize
from textual.geometry import Region, Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from device.quick_look.measures import Point, levelled
from device.surface import Float32Array, HeightMap
from device.tui.drawing.cells import OWN, CellGrid, ColourDepth, fitted_shape
from device.tui.drawing.height_picture import (
    Circle,
    Room,
    frame_cells,
    height_picture,
    picture_rows,
    relief_shape,
    sentence_cells,
    shown_colours,
)
from device.tui.drawing.relief import ProfileCursor


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
        """Return the widget's cells, which fill the room."""
        raise NotImplementedError

    def on_resize(self, _event: Resize) -> None:
        """Draw again at the new size."""
        self._lines = None

    def render_line(self, y: int) -> Strip:
        """Return a row of the picture."""
        if self._lines is None:
            self._cells = self.draw(self.room(self.size.height, self.size.width))
            self._lines = to_strips(self._cells, self.rich_style)
        return self._lines[y] if y < len(self._lines) else Strip.blank(self.size.width, self.rich_style)

    def room(self, rows: int, columns: int) -> Room:
        """Return cells for a picture, in the terminal's colours."""
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
    """Return one strip per row, a segment per run of equal style; `base` shows where cells have default colours."""
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


# The widget that shows the live picture with circles on it.


class LiveView(CellsView):
    """The live picture, or a sentence without one; parameters as for `CellsView`."""

    def __init__(self, depth: ColourDepth, below: int = 0, *, id: str | None = None) -> None:  # noqa: A002
        super().__init__(depth, below, id=id)
        self._picture: NDArray[np.uint8] | None = None
        self._circles: tuple[Circle, ...] = ()
        self._colours: Float32Array | None = None
        self._sentence = "Waiting for the camera."

    def show(self, picture: NDArray[np.uint8] | None, circles: tuple[Circle, ...] = (), sentence: str = "") -> None:
        """Show a picture, uint8 array of shape (h, w, 3), with circles; or the sentence that says why it is missing."""
        if (picture is self._picture, circles, sentence) == (True, self._circles, self._sentence):
            return
        before, self._picture = self._picture, picture
        self._circles, self._sentence = circles, sentence
        shapes = [None if shown is None else shown.shape for shown in (before, picture)]
        if picture is None or shapes[0] != shapes[1]:
            self._colours = None
            self.redraw(layout=shapes[0] != shapes[1])
        else:
            self.redraw_changes()

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:  # noqa: ARG002
        """Return the picture's height, so that the next widget follows directly."""
        rows = max(container.height - self._below, 1)
        return rows if self._picture is None else fitted_shape(self._picture.shape[:2], rows, max(width, 1))[0]

    def draw(self, room: Room) -> CellGrid:
        """Return the picture centred in the room, or the sentence."""
        if self._picture is None:
            return sentence_cells(self._sentence, room)
        self._colours = shown_colours(self._picture, max(room.rows, 1), max(room.columns, 1), self._colours)
        picture = frame_cells(self._colours, room.depth, self._circles)
        cells = CellGrid.empty(room.rows, room.columns, room.depth)
        cells.blit(0, max((room.columns - picture.shape[1]) // 2, 0), picture)
        return cells


# The widget that shows a height map: relief and scale, and a profile under a cursor that keys and touch move.

_STEP: Final = 1.0 / 48.0
_CURSOR_ACTIONS: Final = frozenset({"turn", "move", "hold", "level", "zoom"})

MIN_SHOWN_PX: Final = 16
"""Zoomed in as far as possible, so many pixels of the quick look are shown on its shorter side."""


class HeightView(CellsView, can_focus=True):
    """A height map, or a sentence without one; parameters as for `CellsView`."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("p", "profile", "profile"),
        Binding("v", "view", "picture", show=False),
        Binding("t", "turn", "turn it", show=False),
        Binding("c", "hold", "hold point, measure from it", show=False),
        Binding("l", "level", "level", show=False),
        Binding("plus", "zoom(2)", "zoom in", show=False, key_display="+"),
        Binding("minus", "zoom(0.5)", "zoom out", show=False, key_display="-"),
        Binding("up", "move(-1, 0)", "cursor up", show=False),
        Binding("down", "move(1, 0)", "cursor down", show=False),
        Binding("left", "move(0, -1)", "cursor left", show=False),
        Binding("right", "move(0, 1)", "cursor right", show=False),
    ]

    @dataclass
    class ProfileSwitched(Message):
        """The profile, which uses the arrow keys, was shown or hidden."""

        is_shown: bool

    @dataclass
    class PictureWanted(Message):
        """The map should be shown in pixels."""

        height: HeightMap

    @dataclass
    class Measured(Message):
        """The point that was held and the present one, rows and columns in pixels of the map."""

        height: HeightMap
        first: Point
        second: Point

    def __init__(self, depth: ColourDepth, below: int = 0, *, id: str | None = None) -> None:  # noqa: A002
        super().__init__(depth, below, id=id)
        self._height: HeightMap | None = None
        self._sentence = ""
        self._cursor: ProfileCursor | None = None
        self._held: Point | None = None
        self._level: HeightMap | None = None
        self._zoom = 1.0

    def show(self, height: HeightMap | None, sentence: str = "") -> None:
        """Show a map, or the sentence that says why it is missing."""
        if height is self._height and sentence == self._sentence:
            return
        self._height, self._sentence = height, sentence
        self._held, self._level, self._zoom = None, None, 1.0
        self._redraw()

    def action_profile(self) -> None:
        """Show or hide the profile."""
        self._cursor = None if self._cursor else ProfileCursor()
        self._held, self._zoom = None, 1.0
        self.post_message(self.ProfileSwitched(self._cursor is not None))
        self._redraw()

    def action_view(self) -> None:
        """Ask for the relief in pixels."""
        if self._height is not None:
            self.post_message(self.PictureWanted(self._height))

    def action_turn(self) -> None:
        """Turn the line by 90 degrees."""
        if self._cursor:
            self._cursor = self._cursor.turned()
            self._redraw()

    def action_hold(self) -> None:
        """Hold the point, so that later ones are measured against it; again: let it go."""
        self._held = None if self._held else self._point()
        self._measure()

    def action_level(self) -> None:
        """Show and measure heights above the map's mean plane, or as they are again."""
        if self._height is not None:
            raw = self._height
            self._level = None if self._level else HeightMap(levelled(raw.z_um), raw.pitch_um)
            self._redraw()
            self._measure()

    def action_zoom(self, factor: float) -> None:
        """Show less of the map about the cursor, down to single pixels, or more."""
        if self._height is not None:
            most = max(min(self._height.z_um.shape) / MIN_SHOWN_PX, 1.0)
            self._zoom = min(max(self._zoom * factor, 1.0), most)
            self._redraw()

    def action_move(self, down: int, right: int) -> None:
        """Move the cursor's point by a step."""
        if self._cursor:
            across, along = (down, right) if self._cursor.axis == "row" else (right, down)
            step = _STEP / self._zoom
            self._cursor = self._cursor.moved(across * step, along * step)
            self._redraw()
            self._measure()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enable the cursor's keys only while it is shown over a map."""
        if action == "profile":
            return self._height is not None
        shown = self._cursor is not None and self._height is not None
        return shown if action in _CURSOR_ACTIONS else super().check_action(action, parameters)

    def on_click(self, event: Click) -> None:
        """Move the cursor to the touched place of the relief."""
        if self._height is None:
            return
        cursor, shown = self._cursor or ProfileCursor(), self._shown()
        rows, columns = relief_shape(shown, self.room(self.size.height, self.size.width), cursor)
        row, column = event.y / max(rows - 1, 1), event.x / max(columns - 1, 1)
        if row <= 1.0 and column <= 1.0:
            row, column = self._whole(row, column)
            line, point = (row, column) if cursor.axis == "row" else (column, row)
            self._cursor = ProfileCursor(cursor.axis, line, point)
            self._redraw()
            self._measure()

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:  # noqa: ARG002
        """Return the picture's height, so that the next widget follows directly."""
        room = self.room(max(container.height - self._below, 1), max(width, 1))
        return room.rows if self._height is None else picture_rows(self._shown(), room, self._cursor)

    def draw(self, room: Room) -> CellGrid:
        """Return the picture of the map, or the sentence."""
        if self._height is None:
            return sentence_cells(self._sentence, room)
        origin = self._window()[:2] if self._zoom > 1.0 else (0, 0)
        return height_picture(self._shown(), room, self._shown_cursor(), origin)

    def _map(self) -> HeightMap:
        """Return the map, levelled if that is wanted."""
        found = self._level or self._height
        if found is None:
            raise ValueError("there is no map")
        return found

    def _point(self) -> Point:
        """Return the cursor's point, row and column in pixels of the map."""
        cursor = self._cursor or ProfileCursor()
        row, column = (cursor.line, cursor.point) if cursor.axis == "row" else (cursor.point, cursor.line)
        rows, columns = self._map().z_um.shape
        return float(round(row * (rows - 1))), float(round(column * (columns - 1)))

    def _window(self) -> tuple[int, int, int, int]:
        """Return the first row and column, and size, of what is shown: about the cursor, within the map."""
        rows, columns = self._map().z_um.shape
        height, width = max(round(rows / self._zoom), 2), max(round(columns / self._zoom), 2)
        row, column = self._point()
        top = min(max(round(row) - height // 2, 0), rows - height)
        left = min(max(round(column) - width // 2, 0), columns - width)
        return top, left, height, width

    def _shown(self) -> HeightMap:
        """Return the part of the map that is shown."""
        found = self._map()
        if self._zoom <= 1.0:
            return found
        top, left, height, width = self._window()
        return HeightMap(found.z_um[top : top + height, left : left + width], found.pitch_um)

    def _shown_cursor(self) -> ProfileCursor | None:
        """Return the cursor on the part that is shown."""
        if self._cursor is None or self._zoom <= 1.0:
            return self._cursor
        (row, column), (top, left, height, width) = self._point(), self._window()
        down, right = (row - top) / max(height - 1, 1), (column - left) / max(width - 1, 1)
        line, point = (down, right) if self._cursor.axis == "row" else (right, down)
        return ProfileCursor(self._cursor.axis, line, point)

    def _whole(self, row: float, column: float) -> tuple[float, float]:
        """Return a place on the shown part, fractions, as fractions of the whole map."""
        if self._zoom <= 1.0:
            return row, column
        top, left, height, width = self._window()
        rows, columns = self._map().z_um.shape
        return (top + row * (height - 1)) / max(rows - 1, 1), (left + column * (width - 1)) / max(columns - 1, 1)

    def _measure(self) -> None:
        if self._held is not None and self._held != self._point():
            self.post_message(self.Measured(self._map(), self._held, self._point()))

    def _redraw(self) -> None:
        self.redraw(layout=True)
        self.refresh_bindings()
