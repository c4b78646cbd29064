"""The push button on a GPIO line, with a debounce of its own on the monotonic clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self, TypeVar

from hal.debounce import Debouncer
from hal.errors import ButtonError
from hal.gpio_lines import InputLine, OpenInput
from hal.interfaces import ButtonPress, Clock

Result = TypeVar("Result")


class DebouncedButton:
    """See `hal.interfaces.Button`."""

    def __init__(self, open_line: OpenInput, clock: Clock) -> None:
        self._open_line = open_line
        self._clock = clock
        self._line: InputLine | None = None
        self._debouncer = Debouncer(down=False)

    def wait_for_push(self, timeout_s: float | None) -> int | None:
        """When the next press began (ns), as soon as its contact has come to rest, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            The line cannot be read, or the button was not entered.
        """
        return self._wait(timeout_s, self._debouncer.push)

    def wait_for_press(self, timeout_s: float | None) -> ButtonPress | None:
        """The next press once it is released, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            The line cannot be read, or the button was not entered.
        """
        return self._wait(timeout_s, self._debouncer.take)

    def _wait(self, timeout_s: float | None, look: Callable[[], Result | None]) -> Result | None:
        """What `look` finds as edges come in, or None after `timeout_s`."""
        line = self._opened()
        end_ns = None if timeout_s is None else self._clock.monotonic_ns() + round(timeout_s * 1e9)
        while True:
            self._catch_up(line)
            if (found := look()) is not None:
                return found
            now_ns = self._clock.monotonic_ns()
            if end_ns is not None and now_ns >= end_ns:
                return None
            wake_ns = [at_ns for at_ns in (end_ns, self._debouncer.resting_at_ns()) if at_ns is not None]
            line.wait(max(min(wake_ns) - now_ns, 1) * 1e-9 if wake_ns else None)

    def is_down(self) -> bool:
        """Whether the button is down now."""
        return self._opened().is_active()

    def forget_presses(self) -> int:
        """Drop every press so far; says how many `wait_for_push` had not told."""
        self._catch_up(self._opened())
        return self._debouncer.forget()

    def __enter__(self) -> Self:
        self._line = self._open_line()
        self._debouncer = Debouncer(self._line.is_active())
        return self

    def __exit__(self, *exc: object) -> None:
        line, self._line = self._line, None
        if line is not None:
            line.release()

    def _catch_up(self, line: InputLine) -> None:
        """Hear every edge until now; what is quiet is settled by the line's real level, should an edge be lost.

        A level counts only when no edge came while it was read, or it would be older or newer than what was heard.
        """
        while True:
            while line.wait(0.0):
                for edge in line.edges():
                    self._debouncer.edge(edge.at_ns, edge.active)
            now_ns, active = self._clock.monotonic_ns(), line.is_active()
            if not line.wait(0.0):
                break
        self._debouncer.rest(now_ns, active)

    def _opened(self) -> InputLine:
        if self._line is None:
            raise ButtonError("the button is not opened: enter the hardware before waiting for a press")
        return self._line
