"""The one place where the instrument's threads and its face meet: the present state, and what happened since."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from threading import Lock
from typing import Any

from device.session.events import Event
from device.session.state import InstrumentState


class Noticeboard:
    """State and events, safe to use from any thread."""

    def __init__(self, state: InstrumentState) -> None:
        self._lock = Lock()
        self._state = state
        self._events: deque[Event] = deque(maxlen=1000)

    @property
    def state(self) -> InstrumentState:
        """The present state: an immutable value."""
        return self._state

    def change(self, **what: Any) -> None:
        """Replace some of the state's fields, all of them at once for every reader."""
        with self._lock:
            self._state = replace(self._state, **what)

    def tell(self, event: Event) -> None:
        """Something happened."""
        self._events.append(event)

    def take_events(self) -> tuple[Event, ...]:
        """What happened since the last call, oldest first; a face that never asks loses the oldest."""
        taken = []
        while self._events:
            taken.append(self._events.popleft())
        return tuple(taken)
