"""The push button on a GPIO line, debounced on the monotonic clock.

A level counts once it has been stable for a while, and from the first of its edges.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Self, TypeVar

from hal.drivers.gpio_lines import InputLine, OpenInput
from hal.errors import ButtonError
from hal.interfaces import ButtonPress, Clock

Result = TypeVar("Result")


QUIET_NS: Final = 10_000_000
"""A contact without edges for this long is stable."""


class Debouncer:
    """Turns edges into presses.

    Parameters
    ----------
    down : level at the start; a button that is down then counts from its next press
    """

    def __init__(self, down: bool) -> None:
        self._settled_level = down
        self._level = down
        self._first_ns: int | None = None
        self._last_ns = 0
        self._pressed_ns: int | None = None
        self._presses: list[ButtonPress] = []
        self._reported_ns: int | None = None

    def edge(self, at_ns: int, down: bool) -> None:
        """Add an edge; edges come in order of their times."""
        self.settle(at_ns, self._level)
        if self._first_ns is None:
            self._first_ns = at_ns
        self._last_ns = at_ns
        self._level = down

    def settle(self, now_ns: int, down: bool) -> None:
        """Report that no edge came until now, with the level `down`: a level that was stable long enough counts.

        A level that differs without an edge is treated as an edge now and must become stable: its edges were lost, or
        are still on their way.
        """
        if down != self._level:
            self._first_ns = now_ns if self._first_ns is None else self._first_ns
            self._last_ns, self._level = now_ns, down
        if self._first_ns is None or now_ns - self._last_ns < QUIET_NS:
            return
        began_ns, self._first_ns = self._first_ns, None
        if down == self._settled_level:
            return
        self._settled_level = down
        if down:
            self._pressed_ns = began_ns
        elif self._pressed_ns is not None:
            self._presses.append(ButtonPress(self._pressed_ns, (began_ns - self._pressed_ns) * 1e-9))
            self._pressed_ns = None

    def settles_at_ns(self) -> int | None:
        """When the contact will be stable; None when it is stable now."""
        return None if self._first_ns is None else self._last_ns + QUIET_NS

    def next_push_ns(self) -> int | None:
        """Begin of the next unreported press, ns, released or not; drops presses reported before it."""
        unreported = self._unreported()
        if not unreported:
            return None
        self._reported_ns = unreported[0]
        self._presses = [press for press in self._presses if press.began_ns >= unreported[0]]
        return unreported[0]

    def next_press(self) -> ButtonPress | None:
        """Return the next released press, if any."""
        return self._presses.pop(0) if self._presses else None

    def clear(self) -> int:
        """Drop every press, including one that is still held; returns how many were not reported."""
        dropped = len(self._unreported())
        self._presses.clear()
        self._pressed_ns = None
        return dropped

    def _unreported(self) -> list[int]:
        """Begin of the presses that `next_push_ns` has not reported, ns, oldest first."""
        began = [press.began_ns for press in self._presses]
        if self._pressed_ns is not None:
            began.append(self._pressed_ns)
        return [at_ns for at_ns in began if self._reported_ns is None or at_ns > self._reported_ns]


class DebouncedButton:
    """See `hal.interfaces.Button`."""

    def __init__(self, open_line: OpenInput, clock: Clock) -> None:
        self._open_line = open_line
        self._clock = clock
        self._line: InputLine | None = None
        self._debouncer = Debouncer(down=False)

    def wait_for_push(self, timeout_s: float | None) -> int | None:
        """Begin of the next press (ns), as soon as its contact is stable, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            The line cannot be read, or the button was not entered.
        """
        return self._wait(timeout_s, self._debouncer.next_push_ns)

    def wait_for_press(self, timeout_s: float | None) -> ButtonPress | None:
        """Return the next press after its release, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            The line cannot be read, or the button was not entered.
        """
        return self._wait(timeout_s, self._debouncer.next_press)

    def _wait(self, timeout_s: float | None, poll: Callable[[], Result | None]) -> Result | None:
        """Return the result of `poll` as edges come in, or None after `timeout_s`."""
        line = self._opened()
        end_ns = None if timeout_s is None else self._clock.monotonic_ns() + round(timeout_s * 1e9)
        while True:
            self._catch_up(line)
            if (found := poll()) is not None:
                return found
            now_ns = self._clock.monotonic_ns()
            if end_ns is not None and now_ns >= end_ns:
                return None
            wake_ns = [at_ns for at_ns in (end_ns, self._debouncer.settles_at_ns()) if at_ns is not None]
            line.wait(max(min(wake_ns) - now_ns, 1) * 1e-9 if wake_ns else None)

    def is_down(self) -> bool:
        """Return whether the button is down now."""
        return self._opened().is_active()

    def clear_presses(self) -> int:
        """Drop all presses so far; returns how many `wait_for_push` had not reported."""
        self._catch_up(self._opened())
        return self._debouncer.clear()

    def __enter__(self) -> Self:
        self._line = self._open_line()
        self._debouncer = Debouncer(self._line.is_active())
        return self

    def __exit__(self, *exc: object) -> None:
        line, self._line = self._line, None
        if line is not None:
            line.release()

    def _catch_up(self, line: InputLine) -> None:
        """Process all edges until now, then settle with the line's real level, in case an edge was lost.

        A level counts only when no edge came while it was read, because it would be older or newer than the edges.
        """
        while True:
            while line.wait(0.0):
                for edge in line.edges():
                    self._debouncer.edge(edge.at_ns, edge.active)
            now_ns, active = self._clock.monotonic_ns(), line.is_active()
            if not line.wait(0.0):
                break
        self._debouncer.settle(now_ns, active)

    def _opened(self) -> InputLine:
        if self._line is None:
            raise ButtonError("the button is not opened: enter the hardware before waiting for a press")
        return self._line
