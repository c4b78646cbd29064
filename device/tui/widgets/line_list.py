"""A list of lines with one chosen; it is reversed and has a `>`, so that it is visible without colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.events import Click
from textual.geometry import Region, Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.strip import Strip

from device.tui.drawing.text import shortened


class LineList(ScrollView, can_focus=True):
    """Lines, one of them chosen by touch or arrow keys.

    Parameters
    ----------
    lines : the choices
    chosen : index of the initial choice
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("down", "choose(1)", "choose", key_display="↑↓"),
        Binding("up", "choose(-1)", show=False),
        Binding("pagedown", "choose(10)", show=False),
        Binding("pageup", "choose(-10)", show=False),
        Binding("home", "choose_end(0)", show=False),
        Binding("end", "choose_end(-1)", show=False),
    ]

    @dataclass
    class Chosen(Message):
        """Line `index` was chosen."""

        index: int

    def __init__(self, lines: Sequence[str] = (), chosen: int = 0, *, id: str | None = None) -> None:  # noqa: A002
        super().__init__(id=id)
        self._lines = tuple(lines)
        self._chosen = chosen

    @property
    def chosen(self) -> int | None:
        """Index of the chosen line; None in an empty list."""
        return self._chosen if self._lines else None

    def show(self, lines: Sequence[str], chosen: int = 0) -> None:
        """Show other lines."""
        self._lines = tuple(lines)
        self.virtual_size = Size(self.size.width, len(self._lines))
        self.choose(chosen)

    def choose(self, index: int) -> None:
        """Choose the line nearest to an index."""
        self._chosen = max(min(index, len(self._lines) - 1), 0)
        self.scroll_to_region(Region(0, self._chosen, 1, 1), animate=False)
        self.refresh()
        if self._lines:
            self.post_message(self.Chosen(self._chosen))

    def choose_next(self) -> None:
        """Choose the next line; after the last one the first."""
        self.choose((self._chosen + 1) % max(len(self._lines), 1))

    def action_choose(self, step: int) -> None:
        """Choose the line `step` lines further down."""
        self.choose(self._chosen + step)

    def action_choose_end(self, index: int) -> None:
        """Choose the first line (0) or the last (-1)."""
        self.choose(0 if index == 0 else len(self._lines) - 1)

    def on_click(self, event: Click) -> None:
        """Choose the touched line."""
        row = event.y + self.scroll_offset.y
        if row < len(self._lines):
            self.choose(row)

    def on_mount(self) -> None:
        """Set the scrollable size."""
        self.virtual_size = Size(self.size.width, len(self._lines))

    def render_line(self, y: int) -> Strip:
        """One line."""
        row, width = y + self.scroll_offset.y, self.size.width
        if row >= len(self._lines):
            return Strip.blank(width, self.rich_style)
        is_chosen = row == self._chosen
        text = shortened(f"{'>' if is_chosen else ' '} {self._lines[row]}", width).ljust(width)
        mark = Style(reverse=self.has_focus, bold=True) if is_chosen else Style()
        return Strip([Segment(text, self.rich_style + mark)], width)


class ChoiceList(LineList):
    """A list of actions: Enter, or a touch on the chosen line, starts it."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter", "do", "select", key_display="Enter")]

    class Done(Message):
        """The chosen line's action was started."""

    def action_do(self) -> None:
        """Start the chosen action."""
        self.post_message(self.Done())

    def on_click(self, event: Click) -> None:
        """Choose the touched line; start it if it was chosen already."""
        if event.y + self.scroll_offset.y == self._chosen:
            event.prevent_default()
            self.action_do()
