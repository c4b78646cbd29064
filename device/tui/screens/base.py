"""Common part of every screen: themes, navigation, a body, the last notice, the instrument's state, and the keys."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, Final, cast

from textual.app import ComposeResult
from textual.containers import Container
from textual.screen import Screen
from textual.theme import Theme
from textual.widget import Widget

from device.instrument.instrument import Instrument
from device.instrument.state import InstrumentState
from device.store.choices import Display
from device.tui.drawing.cells import ColourDepth
from device.tui.screens.panels import state_text
from device.tui.widgets.navigation import KeyHints, NavigationBar, Notice, NoticeLine, Place, Words

if TYPE_CHECKING:
    from device.tui.screens.app import RetroscanApp


SPOT_LEFT: Final = "The search for the spot has ended: pushes scan."
AREA_LEFT: Final = "The area has ended: its scans are kept."


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

    async def short_push(self) -> None:
        """Handle a short push of the button on a screen where it does not scan."""

    async def long_push(self) -> bool:
        """Handle a long push; returns False if it should open the next screen."""
        return False


# Colours of the screens: for a terminal with all colours, and for a plain console.


def themes_for(depth: ColourDepth) -> dict[Display, Theme]:
    """Return the dark and the light theme for a terminal's colours; the light one is for the sun: black on white.

    Nothing depends on colour: chosen lines are reversed, important text is bold or has a word.
    """
    if depth == "full":
        return {"dark": _full(), "light": _full_light()}
    return {"dark": _sixteen(), "light": _sixteen_light()}


def _full_light() -> Theme:
    return Theme(
        name="retrograph-light",
        dark=False,
        primary="#003a70",
        secondary="#303030",
        accent="#7a3b00",
        success="#005a1e",
        warning="#7a3b00",
        error="#a00000",
        foreground="#000000",
        background="#ffffff",
        surface="#ffffff",
        panel="#e0e0e0",
        variables={"block-cursor-text-style": "bold", "input-cursor-text-style": "reverse"},
    )


def _sixteen_light() -> Theme:
    return Theme(
        name="retrograph-console-light",
        ansi=True,
        dark=False,
        primary="ansi_blue",
        secondary="ansi_black",
        accent="ansi_red",
        success="ansi_green",
        warning="ansi_red",
        error="ansi_red",
        foreground="ansi_black",
        background="ansi_white",
        surface="ansi_white",
        panel="ansi_white",
        boost="ansi_white",
        variables={
            "ansi-background": "ansi_white",
            "ansi-foreground": "ansi_black",
            "border": "ansi_black",
            "border-blurred": "ansi_black",
            "block-cursor-foreground": "ansi_black",
            "block-cursor-background": "ansi_white",
            "block-cursor-text-style": "reverse",
            "input-cursor-text-style": "reverse",
        },
    )


def _full() -> Theme:
    return Theme(
        name="retrograph",
        primary="#7fb8c9",
        secondary="#8a9ba8",
        accent="#e6c58a",
        success="#8fd0a0",
        warning="#e6c58a",
        error="#f0958a",
        foreground="#d5dce2",
        background="#0f1317",
        surface="#171d23",
        panel="#222b33",
        variables={"block-cursor-text-style": "bold", "input-cursor-text-style": "reverse"},
    )


def _sixteen() -> Theme:
    return Theme(
        name="retrograph-console",
        ansi=True,
        primary="ansi_cyan",
        secondary="ansi_white",
        accent="ansi_bright_yellow",
        success="ansi_bright_green",
        warning="ansi_bright_yellow",
        error="ansi_bright_red",
        foreground="ansi_default",
        background="ansi_default",
        surface="ansi_default",
        panel="ansi_default",
        boost="ansi_default",
        variables={
            "ansi-background": "ansi_black",
            "ansi-foreground": "ansi_white",
            "border": "ansi_white",
            "border-blurred": "ansi_white",
            "block-cursor-foreground": "ansi_default",
            "block-cursor-background": "ansi_default",
            "block-cursor-text-style": "reverse",
            "input-cursor-text-style": "reverse",
        },
    )
