"""The bars that every screen has: screens and device name at the top, the last notice, the keys at the bottom."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Horizontal
from textual.content import Content
from textual.events import Click
from textual.screen import Screen
from textual.visual import VisualType
from textual.widgets import Static

from device.tui.drawing.text import screen_advice

# Words on a screen that are drawn only when they change: a state is shown ten times a second and rarely differs.


class Words(Static):
    """A static text; parameters as for `Static`."""

    _said: tuple[object, ...] | None = None

    def update(self, content: VisualType = "", *, layout: bool = True) -> None:
        """Show other words; the same ones cost nothing."""
        said = (content.plain, *content.spans) if isinstance(content, Content) else (content,)
        if said != self._said:
            self._said = said
            super().update(content, layout=layout)


Place = Literal["scan", "calibrate", "scans", "set-up"]

PLACES: Final[tuple[tuple[Place, str], ...]] = (
    ("scan", "Scan"),
    ("calibrate", "Calibrate"),
    ("scans", "Scans"),
    ("set-up", "Set-up"),
)

KEPT_HINTS: Final = ("keys", "quit", "leave", "faults", "scan", "go_on", "demonstrate")
"""Actions whose hints are kept where not all fit, most important first; `?` lists every key."""

Severity = Literal["info", "success", "error"]

_SIGNS: Final[dict[Severity, str]] = {"info": "", "success": "", "error": "! "}

_STYLES: Final[dict[Severity, str]] = {"info": "", "success": "$success", "error": "$error bold"}


def place_after(place: Place) -> Place:
    """Return the next screen in the bar, opened by a long push of the button."""
    names = [name for name, _ in PLACES]
    return names[(names.index(place) + 1) % len(names)]


class NavigationBar(Horizontal):
    """The four screens; the current one is reversed.

    Parameters
    ----------
    current : the screen that contains this bar
    """

    def __init__(self, current: Place) -> None:
        super().__init__()
        self._current: Place = current
        self._device = Words(id="device-name", markup=False)

    def compose(self) -> ComposeResult:
        """Return one item per screen, and the name of the device."""
        for number, (place, title) in enumerate(PLACES, start=1):
            yield NavigationItem(place, number, title, place == self._current)
        yield self._device

    def show_device(self, name: str) -> None:
        """Show the instrument's name."""
        self._device.update(name)


class NavigationItem(Static):
    """A screen's name; a touch opens it."""

    def __init__(self, place: Place, number: int, title: str, is_current: bool) -> None:
        text = Content(f" {number} {title} ")
        super().__init__(text, classes="-current" if is_current else "")
        self._place = place

    async def on_click(self, event: Click) -> None:
        """Open the screen."""
        event.stop()
        await self.run_action(f"app.go('{self._place}')")


class KeyHints(Horizontal):
    """The active key bindings; those that do not fit are left out as a whole, never that of all keys."""

    _shown: dict[str, Binding] | None = None

    def compose(self) -> ComposeResult:
        """Return one hint per key, as many as fit."""
        self._shown = self._active()
        hints = {
            action: KeyHint(self.app.get_key_display(binding), binding.description, binding.key)
            for action, binding in self._shown.items()
        }
        fitting = hints_that_fit({action: hint.columns for action, hint in hints.items()}, self.app.size.width)
        yield from (hints[action] for action in fitting)

    def on_mount(self) -> None:
        """Subscribe to changes of the bindings."""
        self.screen.bindings_updated_signal.subscribe(self, self._follow)

    def on_resize(self) -> None:
        """Show more hints, or fewer."""
        self.call_after_refresh(self.recompose)

    def _follow(self, screen: Screen[object]) -> None:
        """Show other hints where other keys are active; the same ones are not drawn again."""
        if self.is_attached and screen is self.screen and self._active() != self._shown:
            self.call_after_refresh(self.recompose)

    def _active(self) -> dict[str, Binding]:
        """Return the bindings that have a hint, by action."""
        shown: dict[str, Binding] = {}
        for active in self.screen.active_bindings.values():
            if active.enabled and active.binding.show:
                shown.setdefault(active.binding.action, active.binding)
        return shown


def hints_that_fit(columns: Mapping[str, int], available: int) -> list[str]:
    """Actions whose hints fit beside each other, that of all keys first, the others in their order.

    Parameters
    ----------
    columns : width of each hint by action, in the order of the screen
    available : width of the line
    """
    chosen, left = set(), available + 1  # a hint ends in a blank, which the last one may lose
    for action in [*(action for action in KEPT_HINTS if action in columns), *columns]:
        if action not in chosen and columns[action] <= left:
            chosen.add(action)
            left -= columns[action]
    return sorted((action for action in columns if action in chosen), key=lambda action: action != KEPT_HINTS[0])


class KeyHint(Static):
    """One key and its action; a touch presses it."""

    def __init__(self, shown: str, description: str, key: str) -> None:
        text = Content.assemble((f" {shown} ", "$accent bold"), (f"{description} ", ""))
        super().__init__(text)
        self.key = key
        self.columns = text.cell_length

    def on_click(self, event: Click) -> None:
        """Press the key."""
        event.stop()
        self.app.simulate_key(self.key)


@dataclass(frozen=True, slots=True)
class Notice:
    """A sentence and its severity."""

    sentence: str
    severity: Severity = "info"

    @property
    def lasts(self) -> bool:
        """Return whether it names a failure, or work that goes on: its outcome replaces it."""
        return self.severity == "error" or self.sentence.endswith("...")


class NoticeLine(Words):
    """The last notice; an empty line without one, so that the layout stays."""

    def show(self, notice: Notice | None) -> None:
        """Show a notice, or none."""
        if notice is None:
            self.update("")
            return
        sentence = _SIGNS[notice.severity] + screen_advice(notice.sentence)
        self.update(Content.styled(sentence, _STYLES[notice.severity]))
