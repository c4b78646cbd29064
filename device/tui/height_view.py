"""The widget that shows a height map: relief and scale, and a profile under a cursor that keys and touch move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

from textual.binding import Binding, BindingType
from textual.events import Click, Resize
from textual.geometry import Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from device.surface import HeightMap
from device.tui.height_picture import RoomForHeight, height_picture, picture_rows, relief_shape, sentence_cells
from device.tui.profile import ProfileCursor
from device.tui.strips import strips
from device.tui.terminal import ColourDepth

_STEP: Final = 1.0 / 48.0


class HeightView(Widget, can_focus=True):
    """A height map, or a sentence while there is none.

    Parameters
    ----------
    depth : the terminal's colours
    below : rows to keep free below, for what belongs to the map
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("p", "profile", "profile"),
        Binding("v", "view", "picture", show=False),
        Binding("t", "turn", "turn it", show=False),
        Binding("up", "move(-1, 0)", show=False),
        Binding("down", "move(1, 0)", show=False),
        Binding("left", "move(0, -1)", show=False),
        Binding("right", "move(0, 1)", show=False),
    ]

    @dataclass
    class ProfileSwitched(Message):
        """The profile, which takes the arrow keys, was shown or hidden."""

        is_shown: bool

    @dataclass
    class PictureWanted(Message):
        """This map is to be seen to the pixel."""

        height: HeightMap

    def __init__(self, depth: ColourDepth, below: int = 0, *, id: str | None = None) -> None:  # noqa: A002
        super().__init__(id=id)
        self._below = below
        self._depth: ColourDepth = depth
        self._height: HeightMap | None = None
        self._sentence = ""
        self._cursor: ProfileCursor | None = None
        self._lines: list[Strip] | None = None

    def show(self, height: HeightMap | None, sentence: str = "") -> None:
        """Show a map, or the sentence that says why there is none."""
        if height is self._height and sentence == self._sentence:
            return
        self._height, self._sentence = height, sentence
        self._redraw()

    def action_profile(self) -> None:
        """Show or hide the profile."""
        self._cursor = None if self._cursor else ProfileCursor()
        self.post_message(self.ProfileSwitched(self._cursor is not None))
        self._redraw()

    def action_view(self) -> None:
        """Ask for the relief to the pixel."""
        if self._height is not None:
            self.post_message(self.PictureWanted(self._height))

    def action_turn(self) -> None:
        """Turn the line by a quarter."""
        if self._cursor:
            self._cursor = self._cursor.turned()
            self._redraw()

    def action_move(self, down: int, right: int) -> None:
        """Move the cursor's point by a step."""
        if self._cursor:
            across, along = (down, right) if self._cursor.axis == "row" else (right, down)
            self._cursor = self._cursor.moved(across * _STEP, along * _STEP)
            self._redraw()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """The cursor's keys belong to others while there is no cursor."""
        if action == "profile":
            return self._height is not None
        return self._cursor is not None if action in {"turn", "move"} else super().check_action(action, parameters)

    def on_click(self, event: Click) -> None:
        """Put the cursor where the relief was touched."""
        if self._height is None:
            return
        cursor = self._cursor or ProfileCursor()
        rows, columns = relief_shape(
            self._height, RoomForHeight(self.size.height, self.size.width, self._depth), cursor
        )
        row, column = event.y / max(rows - 1, 1), event.x / max(columns - 1, 1)
        if row <= 1.0 and column <= 1.0:
            line, point = (row, column) if cursor.axis == "row" else (column, row)
            self._cursor = ProfileCursor(cursor.axis, line, point)
            self._redraw()

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:  # noqa: ARG002
        """As high as the picture becomes, so that what stands below joins it."""
        room = RoomForHeight(max(container.height - self._below, 1), max(width, 1), self._depth)
        return room.rows if self._height is None else picture_rows(self._height, room, self._cursor)

    def on_resize(self, _event: Resize) -> None:
        """Draw anew at the new size."""
        self._lines = None

    def render_line(self, y: int) -> Strip:
        """One row of the picture."""
        if self._lines is None:
            self._lines = self._draw(self.size)
        return self._lines[y] if y < len(self._lines) else Strip.blank(self.size.width, self.rich_style)

    def _redraw(self) -> None:
        self._lines = None
        self.refresh(layout=True)
        self.refresh_bindings()

    def _draw(self, size: Size) -> list[Strip]:
        room = RoomForHeight(size.height, size.width, self._depth)
        if self._height is None:
            return strips(sentence_cells(self._sentence, room), self.rich_style)
        return strips(height_picture(self._height, room, self._cursor), self.rich_style)
