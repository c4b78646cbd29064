"""Dialogs: fields to edit, a question to confirm, a list to choose from; Escape cancels all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, TypeVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Static

from device.tui.widgets.line_list import ChoiceList

Answer = TypeVar("Answer")


class Dialog(ModalScreen[Answer]):
    """A dialog that the instrument's one button can answer too."""

    def pushed(self, held_long: bool) -> None:
        """Move the focus with a short push, press the focused button with a long one."""
        if not held_long:
            self.focus_next()
        elif isinstance(self.focused, Button):
            self.focused.press()


class FieldsDialog(Dialog[dict[str, str] | None]):
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
        """The fields and two buttons."""
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
        """One line per key."""
        with Vertical(classes="dialog"):
            yield Static("Keys of this screen", classes="dialog-title", markup=False)
            with VerticalScroll(classes="dialog-keys"):
                yield Static("\n".join(f"{key:<10} {what}" for key, what in self.keys), markup=False)
            yield Static("↑ ↓: more · Escape: close", classes="dialog-hint", markup=False)


class ConfirmDialog(Dialog[bool]):
    """A question answered yes or no; the default is no.

    Parameters
    ----------
    question : what is about to happen
    yes : label of the button that confirms
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "dismiss(True)", "yes"),
        Binding("n,escape", "dismiss(False)", "no"),
    ]

    def __init__(self, question: str, yes: str) -> None:
        super().__init__()
        self._question, self._yes = question, yes

    def compose(self) -> ComposeResult:
        """The question and two buttons."""
        with Vertical(classes="dialog"):
            yield Static(self._question, classes="dialog-title", markup=False)
            with Horizontal(classes="dialog-buttons"):
                yield Button(_framed("No, n"), id="no", compact=True)
                yield Button(_framed(f"{self._yes}, y"), id="yes", compact=True)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Return the answer."""
        self.dismiss(event.button.id == "yes")


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
        """The title, the list and a hint."""
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
    """A button's label in brackets, so that it is visible as a button without colour."""
    return Content(f"[ {word} ]")
