"""The small dialogs: a few fields to edit, or a question to confirm; Escape always leaves things as they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, TypeVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Static

from device.tui.line_list import ChoiceList

Answer = TypeVar("Answer")


class Dialog(ModalScreen[Answer]):
    """A dialog that the instrument's one button can answer too."""

    def pushed(self, held_long: bool) -> None:
        """A short push goes to the next field or button, a long one presses the button that has the focus."""
        if not held_long:
            self.focus_next()
        elif isinstance(self.focused, Button):
            self.focused.press()


class FieldsDialog(Dialog[dict[str, str] | None]):
    """A field a line; what comes back are the texts by name, or None when nothing is to change.

    Parameters
    ----------
    title : what is edited
    fields : names and what they hold now
    hint : one sentence below
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "dismiss(None)", "leave as it is")]

    def __init__(self, title: str, fields: Mapping[str, str], hint: str) -> None:
        super().__init__()
        self._title, self._fields, self._hint = title, dict(fields), hint

    def compose(self) -> ComposeResult:
        """The fields, and two buttons."""
        with Vertical(classes="dialog"):
            yield Static(self._title, classes="dialog-title", markup=False)
            for name, text in self._fields.items():
                with Horizontal(classes="dialog-field"):
                    yield Static(name, classes="dialog-label", markup=False)
                    yield Input(text, name=name, compact=True, max_length=80)
            yield Static(self._hint, classes="dialog-hint", markup=False)
            with Horizontal(classes="dialog-buttons"):
                yield Button(_framed("Keep"), id="keep", compact=True)
                yield Button(_framed("Leave as it is"), id="leave", compact=True)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Enter leads to the next field, and from the last one keeps all."""
        inputs = list(self.query(Input))
        if event.input is inputs[-1]:
            self._keep()
        else:
            self.focus_next()

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Keep, or leave as it is."""
        if event.button.id == "keep":
            self._keep()
        else:
            self.dismiss(None)

    def _keep(self) -> None:
        self.dismiss({field.name or "": field.value.strip() for field in self.query(Input)})


class ConfirmDialog(Dialog[bool]):
    """A question that is answered yes or no; no is what a careless Enter gives.

    Parameters
    ----------
    question : what is about to happen
    yes : the word on the button that does it
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "dismiss(True)", "yes"),
        Binding("n,escape", "dismiss(False)", "no"),
    ]

    def __init__(self, question: str, yes: str) -> None:
        super().__init__()
        self._question, self._yes = question, yes

    def compose(self) -> ComposeResult:
        """The question, and two buttons."""
        with Vertical(classes="dialog"):
            yield Static(self._question, classes="dialog-title", markup=False)
            with Horizontal(classes="dialog-buttons"):
                yield Button(_framed("No, n"), id="no", compact=True)
                yield Button(_framed(f"{self._yes}, y"), id="yes", compact=True)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Answer."""
        self.dismiss(event.button.id == "yes")


class ChoiceDialog(Dialog[int]):
    """A list to choose from; what comes back is the index, or None when things stay as they are.

    Parameters
    ----------
    title : what is chosen
    lines : what there is to choose from
    chosen : where to begin
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "dismiss(None)", "leave as it is")]

    def __init__(self, title: str, lines: Sequence[str], chosen: int = 0) -> None:
        super().__init__()
        self._title = title
        self._list = ChoiceList(lines, chosen)

    def compose(self) -> ComposeResult:
        """The title and the list."""
        with Vertical(classes="dialog"):
            yield Static(self._title, classes="dialog-title", markup=False)
            yield self._list
            yield Static("Enter: choose · Escape: leave as it is", classes="dialog-hint", markup=False)

    def on_choice_list_done(self) -> None:
        """Take the chosen line."""
        self.dismiss(self._list.chosen)

    def pushed(self, held_long: bool) -> None:
        """A short push is the next line, a long one takes it."""
        if held_long:
            self.dismiss(self._list.chosen)
        else:
            self._list.choose_next()


def _framed(word: str) -> Content:
    """A button's word between brackets, so that it is seen to be one without colour."""
    return Content(f"[ {word} ]")
