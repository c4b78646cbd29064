"""What every screen has: the bar of screens, a body, the last notice, the state of the instrument, and the keys."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, cast

from textual.app import ComposeResult
from textual.containers import Container
from textual.screen import Screen
from textual.widget import Widget
from textual.widgets import Static

from device.session.instrument import Instrument
from device.session.state import InstrumentState
from device.tui.key_hints import KeyHints
from device.tui.navigation import NavigationBar, Place
from device.tui.notice import Notice, NoticeLine
from device.tui.state_line import state_text

if TYPE_CHECKING:
    from device.tui.app import RetroscanApp


class InstrumentScreen(Screen[None]):
    """A screen of the instrument: subclasses give it a body and follow the state.

    Parameters
    ----------
    instrument : what is shown and told what to do
    """

    PLACE: ClassVar[Place]

    def __init__(self, instrument: Instrument) -> None:
        super().__init__()
        self.instrument = instrument
        self._bar = NavigationBar(self.PLACE)
        self._notice = NoticeLine(id="notice", markup=False)
        self._state = Static(id="state", markup=False)

    @property
    def retroscan(self) -> RetroscanApp:
        """The app, by its own type."""
        return cast("RetroscanApp", self.app)

    def compose(self) -> ComposeResult:
        """Bar, body, notice, state, keys."""
        yield self._bar
        with Container(id="body"):
            yield from self.body()
        yield self._notice
        yield self._state
        yield KeyHints()

    def body(self) -> Iterable[Widget]:
        """What this screen shows between bar and notice."""
        raise NotImplementedError

    def look(self, state: InstrumentState, notice: Notice | None) -> None:
        """Show the present state."""
        self._bar.show_device(state.device_id)
        self._notice.show(notice)
        self._state.update(state_text(state, self.size.width - 2))
        self.follow(state)

    def follow(self, state: InstrumentState) -> None:
        """Show what of the state is this screen's own."""
        raise NotImplementedError

    def look_live(self, state: InstrumentState) -> None:
        """Show the live picture, when this screen has one; called less often where the terminal is slow."""

    async def short_push(self) -> None:
        """What a short push of the button does here, where it does not scan."""

    async def long_push(self) -> bool:
        """Whether a long push of the button did something here; else it opens the next screen."""
        return False
