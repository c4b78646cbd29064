"""The widget that shows a height map: relief and scale, and a profile under a cursor that keys and touch move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

from textual.binding import Binding, BindingType
from textual.events import Click
from textual.geometry import Size
from textual.message import Message

from device.surface.fields import HeightMap
from device.tui.drawing.cells import CellGrid, ColourDepth
from device.tui.drawing.height_picture import Room, height_picture, picture_rows, relief_shape, sentence_cells
from device.tui.drawing.profile import ProfileCursor
from device.tui.widgets.cells_view import CellsView

_STEP: Final = 1.0 / 48.0


class HeightView(CellsView, can_focus=True):
    """A height map, or a sentence without one; parameters as for `CellsView`."""

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
        """The profile, which uses the arrow keys, was shown or hidden."""

        is_shown: bool

    @dataclass
    class PictureWanted(Message):
        """The map should be shown in pixels."""

        height: HeightMap

    def __init__(self, depth: ColourDepth, below: int = 0, *, id: str | None = None) -> None:  # noqa: A002
        super().__init__(depth, below, id=id)
        self._height: HeightMap | None = None
        self._sentence = ""
        self._cursor: ProfileCursor | None = None

    def show(self, height: HeightMap | None, sentence: str = "") -> None:
        """Show a map, or the sentence that says why it is missing."""
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
        """Ask for the relief in pixels."""
        if self._height is not None:
            self.post_message(self.PictureWanted(self._height))

    def action_turn(self) -> None:
        """Turn the line by 90 degrees."""
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
        """Enable the cursor's keys only while it is shown."""
        if action == "profile":
            return self._height is not None
        return self._cursor is not None if action in {"turn", "move"} else super().check_action(action, parameters)

    def on_click(self, event: Click) -> None:
        """Move the cursor to the touched place of the relief."""
        if self._height is None:
            return
        cursor = self._cursor or ProfileCursor()
        rows, columns = relief_shape(self._height, self.room(self.size.height, self.size.width), cursor)
        row, column = event.y / max(rows - 1, 1), event.x / max(columns - 1, 1)
        if row <= 1.0 and column <= 1.0:
            line, point = (row, column) if cursor.axis == "row" else (column, row)
            self._cursor = ProfileCursor(cursor.axis, line, point)
            self._redraw()

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:  # noqa: ARG002
        """The picture's height, so that the next widget follows directly."""
        room = self.room(max(container.height - self._below, 1), max(width, 1))
        return room.rows if self._height is None else picture_rows(self._height, room, self._cursor)

    def draw(self, room: Room) -> CellGrid:
        """The picture of the map, or the sentence."""
        if self._height is None:
            return sentence_cells(self._sentence, room)
        return height_picture(self._height, room, self._cursor)

    def _redraw(self) -> None:
        self.redraw(layout=True)
        self.refresh_bindings()
