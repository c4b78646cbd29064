"""Common part of every screen: themes, navigation, a body, the last notice, the instrument's state, and the keys."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, ClassVar, Final, TypeVar, cast

from textual.app import ComposeResult
from textual.containers import Container
from textual.screen import Screen
from textual.theme import Theme
from textual.widget import Widget

from device.errors import DeviceError
from device.instrument.instrument import Instrument
from device.instrument.state import InstrumentState
from device.store.choices import Display
from device.tui.drawing.cells import ColourDepth
from device.tui.screens.panels import state_text
from device.tui.widgets.dialogs import Answer, Dialog
from device.tui.widgets.navigation import KeyHints, NavigationBar, Notice, NoticeLine, Place, Words

if TYPE_CHECKING:
    from device.tui.screens.app import RetroscanApp


SPOT_LEFT: Final = "The search for the spot has ended: pushes scan."
AREA_LEFT: Final = "The area has ended: its scans are kept."

Result = TypeVar("Result")


class InstrumentScreen(Screen[None]):
    """A screen of the instrument; subclasses provide the body and update it.

    Parameters
    ----------
    instrument : shown and controlled by the screen
    """

    PLACE: ClassVar[Place]

    def __init__(self, instrument: Instrument) -> None:
        super().__init__()
        self.instrument = instrument
        self._bar = NavigationBar(self.PLACE)
        self._notice = NoticeLine(id="notice", markup=False)
        self._state = Words(id="state", markup=False)

    @property
    def retroscan(self) -> RetroscanApp:
        """The app with its own type."""
        return cast("RetroscanApp", self.app)

    def compose(self) -> ComposeResult:
        """Navigation, body, notice, state and keys."""
        yield self._bar
        with Container(id="body"):
            yield from self.body()
        yield self._notice
        yield self._state
        yield KeyHints()

    def body(self) -> Iterable[Widget]:
        """Return the widgets between navigation and notice."""
        raise NotImplementedError

    def show_state(self, state: InstrumentState, notice: Notice | None) -> None:
        """Show the present state and the last notice."""
        self._bar.show_device(state.device_id)
        self._notice.show(notice)
        self._state.update(state_text(state, self.size.width - 2))
        self.show_body(state)

    def show_body(self, state: InstrumentState) -> None:
        """Update the body."""
        raise NotImplementedError

    def show_live(self, state: InstrumentState) -> None:
        """Show the live picture, if this screen has one; called less often on a slow terminal."""

    def work(
        self, task: Callable[[], Result], show: Callable[[Result], object], group: str = "", exclusive: bool = False
    ) -> None:
        """Work on another thread, so that a slow disk does not block the screens; then show the result, or the failure.

        group, exclusive : passed to Textual's worker
        """

        def work_and_show() -> None:
            try:
                result = task()
            except DeviceError as error:
                self.app.call_from_thread(self.retroscan.report_failure, str(error))
            else:
                self.app.call_from_thread(show, result)

        self.run_worker(work_and_show, thread=True, group=group, exclusive=exclusive)

    def ask(self, dialog: Dialog[Answer], answered: Callable[[Answer], object]) -> None:
        """Show a dialog, and call `answered` with its answer unless it is cancelled."""

        def closed(answer: Answer | None) -> None:
            if answer is not None:
                answered(answer)

        self.app.push_screen(dialog, closed)

    async def short_push(self) -> None:
        """Handle a short push of the button on a screen where it does not scan."""

    async def long_push(self) -> bool:
        """Handle a long push; returns False if it should open the next screen."""
        return False


# Colours of the screens: for a terminal with all colours, and for a plain console.

COLOURS: Final = {
    "retrograph": (
        ("#7fb8c9", "#8a9ba8", "#e6c58a", "#f0958a", "#8fd0a0", "#e6c58a"),
        ("#d5dce2", "#0f1317", "#171d23", "#222b33"),
    ),
    "retrograph-light": (
        ("#003a70", "#303030", "#7a3b00", "#a00000", "#005a1e", "#7a3b00"),
        ("#000000", "#ffffff", "#ffffff", "#e0e0e0"),
    ),
    "retrograph-console": (
        ("ansi_cyan", "ansi_white", "ansi_bright_yellow", "ansi_bright_red", "ansi_bright_green", "ansi_bright_yellow"),
        ("ansi_default", "ansi_default", "ansi_default", "ansi_default"),
    ),
    "retrograph-console-light": (
        ("ansi_blue", "ansi_black", "ansi_red", "ansi_red", "ansi_green", "ansi_red"),
        ("ansi_black", "ansi_white", "ansi_white", "ansi_white"),
    ),
}
"""Of each theme: primary, secondary, warning, error, success and accent; foreground, background, surface and panel."""


def themes_for(depth: ColourDepth) -> dict[Display, Theme]:
    """Return the dark and the light theme for a terminal's colours; the light one is for the sun: black on white.

    Nothing depends on colour: chosen lines are reversed, important text is bold or has a word.
    """
    name, ansi = ("retrograph", False) if depth == "full" else ("retrograph-console", True)
    return {"dark": _theme(name, dark=True, ansi=ansi), "light": _theme(f"{name}-light", dark=False, ansi=ansi)}


def _theme(name: str, *, dark: bool, ansi: bool) -> Theme:
    meanings, grounds = COLOURS[name]
    variables = {"block-cursor-text-style": "reverse" if ansi else "bold", "input-cursor-text-style": "reverse"}
    if ansi:
        ink, paper = ("ansi_white", "ansi_black") if dark else ("ansi_black", "ansi_white")
        variables |= {"ansi-foreground": ink, "ansi-background": paper, "border": ink, "border-blurred": ink}
        variables |= {"block-cursor-foreground": grounds[0], "block-cursor-background": grounds[1]}
    boost = grounds[-1] if ansi else None
    return Theme(name, *meanings, *grounds, boost, dark=dark, variables=variables, ansi=ansi)
