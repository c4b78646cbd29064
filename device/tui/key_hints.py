"""The bar at the bottom: every key that does something here, and the same by touch."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.content import Content
from textual.events import Click
from textual.screen import Screen
from textual.widgets import Static


class KeyHints(Horizontal):
    """Keys and what they do, from the bindings that hold now; hints that no longer fit are left out, the last first."""

    def compose(self) -> ComposeResult:
        """A hint a key."""
        hints: dict[str, KeyHint] = {}
        for active in self.screen.active_bindings.values():
            binding = active.binding
            if binding.show and active.enabled and binding.action not in hints:
                hints[binding.action] = KeyHint(self.app.get_key_display(binding), binding.description, binding.key)
        yield from hints.values()

    def on_mount(self) -> None:
        """Follow the bindings as they change."""
        self.screen.bindings_updated_signal.subscribe(self, self._follow)

    def _follow(self, screen: Screen[object]) -> None:
        if self.is_attached and screen is self.screen:
            self.call_after_refresh(self.recompose)


class KeyHint(Static):
    """One key and what it does; a touch presses it."""

    def __init__(self, shown: str, description: str, key: str) -> None:
        super().__init__(Content.assemble((f" {shown} ", "$accent bold"), (f"{description} ", "")))
        self._key = key

    def on_click(self, event: Click) -> None:
        """Press the key."""
        event.stop()
        self.app.simulate_key(self._key)
