"""Dialogs: fields to edit, a question to confirm, a list to choose from; Escape cancels all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from rich.segment import Segment
from rich.style import Style
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.events import Click
from textual.geometry import Region, Size
from textual.message import Message
from textual.screen import ModalScreen
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widgets import Button, Input, Static

from device.tui.drawing.text import shortened

Answer = TypeVar("Answer")


class Dialog(ModalScreen[Answer]):
    """A dialog that the instrument's one button can answer too."""

    def pushed(self, held_long: bool) -> None:
        """Move the focus with a short push, press the focused button with a long one."""
        if not held_long:
            self.focus_next()
        elif isinstance(self.focused, Button):
            self.focused.press()


class FieldsDialog(Dialog[dict[str, str]]):
    """One field per line; returns the texts by name, or None if cancelled.

    Parameters
    ----------
    title : what is edited
    fields : names and present texts
    hint : one sentence below
    check : what is wrong with the texts, empty if nothing is; the dialog then stays open with what was typed
    secret : name of the field that shows dots instead of its text
    replaces : what is typed takes the place of the present texts
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "dismiss(None)", "cancel")]

    def __init__(
        self,
        title: str,
        fields: Mapping[str, str],
        hint: str,
        check: Callable[[dict[str, str]], str] = lambda _: "",
        secret: str = "",
        *,
        replaces: bool = False,
    ) -> None:
        super().__init__()
        self._secret = secret
        self._replaces = replaces
        self._title, self._fields, self._hint = title, dict(fields), Static(hint, classes="dialog-hint", markup=False)
        self._check = check

    def compose(self) -> ComposeResult:
        """Return the fields and two buttons."""
        with Vertical(classes="dialog"):
            yield Static(self._title, classes="dialog-title", markup=False)
            for name, text in self._fields.items():
                with Horizontal(classes="dialog-field"):
                    yield Static(name, classes="dialog-label", markup=False)
                    yield Input(
                        text,
                        name=name,
                        compact=True,
                        max_length=80,
                        select_on_focus=self._replaces,
                        password=name == self._secret,
                    )
            yield self._hint
            with Horizontal(classes="dialog-buttons"):
                yield Button(_framed("Save"), id="save", compact=True)
                yield Button(_framed("Cancel"), id="cancel", compact=True)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Go to the next field; from the last one save."""
        inputs = list(self.query(Input))
        if event.input is inputs[-1]:
            self._save()
        else:
            self.focus_next()

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Save or cancel."""
        if event.button.id == "save":
            self._save()
        else:
            self.dismiss(None)

    def _save(self) -> None:
        """Close with the texts, or say what is wrong and go to the field whose text is named."""
        texts = {
            field.name or "": field.value if field.password else field.value.strip() for field in self.query(Input)
        }
        if complaint := self._check(texts):
            self._hint.update(f"! {complaint}")
            for field in self.query(Input):
                if not field.password and f"'{texts[field.name or '']}'" in complaint:
                    field.focus()
                    break
        else:
            self.dismiss(texts)


class KeysDialog(Dialog[None]):
    """Every key of a screen with what it does.

    Parameters
    ----------
    keys : shown key and description
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape,enter,question_mark", "dismiss(None)", "close")]

    def __init__(self, keys: Sequence[tuple[str, str]]) -> None:
        super().__init__()
        self.keys = keys

    def compose(self) -> ComposeResult:
        """Return one line per key."""
        with Vertical(classes="dialog"):
            yield Static("Keys of this screen", classes="dialog-title", markup=False)
            with VerticalScroll(classes="dialog-keys"):
                yield Static("\n".join(f"{key:<10} {what}" for key, what in self.keys), markup=False)
            yield Static("↑ ↓: more · Escape: close", classes="dialog-hint", markup=False)


class ConfirmDialog(Dialog[bool]):
    """A question answered yes or no; returns True, or None for no, which is the default.

    Parameters
    ----------
    question : what is about to happen
    yes : label of the button that confirms
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "dismiss(True)", "yes"),
        Binding("n,escape", "dismiss(None)", "no"),
    ]

    def __init__(self, question: str, yes: str) -> None:
        super().__init__()
        self._question, self._yes = question, yes

    def compose(self) -> ComposeResult:
        """Return the question and two buttons."""
        with Vertical(classes="dialog"):
            yield Static(self._question, classes="dialog-title", markup=False)
            with Horizontal(classes="dialog-buttons"):
                yield Button(_framed("No, n"), id="no", compact=True)
                yield Button(_framed(f"{self._yes}, y"), id="yes", compact=True)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Return the answer."""
        self.dismiss(True if event.button.id == "yes" else None)


class ChoiceDialog(Dialog[int]):
    """A list to choose from; returns the index, or None if cancelled.

    Parameters
    ----------
    title : what is chosen
    lines : the choices
    chosen : index of the initial choice
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "dismiss(None)", "cancel")]

    def __init__(self, title: str, lines: Sequence[str], chosen: int = 0) -> None:
        super().__init__()
        self._title = title
        self._list = ChoiceList(lines, chosen)

    def compose(self) -> ComposeResult:
        """Return the title, the list and a hint."""
        with Vertical(classes="dialog"):
            yield Static(self._title, classes="dialog-title", markup=False)
            yield self._list
            yield Static("Enter: select · Escape: cancel", classes="dialog-hint", markup=False)

    def on_choice_list_done(self) -> None:
        """Return the chosen line."""
        self.dismiss(self._list.chosen)

    def pushed(self, held_long: bool) -> None:
        """Choose the next line with a short push, return it with a long one."""
        if held_long:
            self.dismiss(self._list.chosen)
        else:
            self._list.choose_next()


def _framed(word: str) -> Content:
    """Return a button's label in brackets, so that it is visible as a button without colour."""
    return Content(f"[ {word} ]")


# A list of lines with one chosen; it is reversed and has a `>`, so that it is visible without colour.


class LineList(ScrollView, can_focus=True):
    """Lines, one of them chosen by touch or arrow keys.

    Parameters
    ----------
    lines : the choices
    chosen : index of the initial choice
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("down", "choose(1)", "choose", key_display="↑↓"),
        Binding("up", "choose(-1)", "previous line", show=False),
        Binding("pagedown", "choose(10)", "ten lines on", show=False),
        Binding("pageup", "choose(-10)", "ten lines back", show=False),
        Binding("home", "choose_end(0)", "first line", show=False),
        Binding("end", "choose_end(-1)", "last line", show=False),
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
        """Return one line."""
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
