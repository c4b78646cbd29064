"""The bar at the top: the four screens, each with the key that opens it, and what instrument this is."""

from __future__ import annotations

from typing import Final, Literal

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.content import Content
from textual.events import Click
from textual.widgets import Static

Place = Literal["scan", "calibrate", "scans", "set-up"]

PLACES: Final[tuple[tuple[Place, str], ...]] = (
    ("scan", "Scan"),
    ("calibrate", "Calibrate"),
    ("scans", "Scans"),
    ("set-up", "Set-up"),
)


def place_after(place: Place) -> Place:
    """The screen that a long push of the button leads to."""
    names = [name for name, _ in PLACES]
    return names[(names.index(place) + 1) % len(names)]


class NavigationBar(Horizontal):
    """The four screens; the current one is reversed.

    Parameters
    ----------
    current : the screen that this bar stands on
    """

    def __init__(self, current: Place) -> None:
        super().__init__()
        self._current: Place = current
        self._device = Static(id="device-name", markup=False)

    def compose(self) -> ComposeResult:
        """An item a screen, and the name of the device."""
        for number, (place, title) in enumerate(PLACES, start=1):
            yield NavigationItem(place, number, title, place == self._current)
        yield self._device

    def show_device(self, name: str) -> None:
        """Show which instrument this is."""
        self._device.update(name)


class NavigationItem(Static):
    """One screen's name: a touch opens it."""

    def __init__(self, place: Place, number: int, title: str, is_current: bool) -> None:
        text = Content(f" {number} {title} ")
        super().__init__(text, classes="-current" if is_current else "")
        self._place = place

    async def on_click(self, event: Click) -> None:
        """Open the screen."""
        event.stop()
        await self.run_action(f"app.go('{self._place}')")
