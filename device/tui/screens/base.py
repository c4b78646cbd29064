"""Common part of every screen: navigation, a body, the last notice, the instrument's state, and the keys."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, Final, cast

from textual.app import ComposeResult
from textual.containers import Container
from textual.screen import Screen
from textual.widget import Widget

from device.instrument.instrument import Instrument
from device.instrument.state import InstrumentState
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
