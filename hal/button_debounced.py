"""The push button on a GPIO line, with a debounce of its own on the monotonic clock."""

from __future__ import annotations

from typing import Self

from hal.debounce import Debouncer
from hal.errors import ButtonError
from hal.gpio_lines import InputLine, OpenInput
from hal.interfaces import ButtonPress, Clock


class DebouncedButton:
    """See `hal.interfaces.Button`."""

    def __init__(self, open_line: OpenInput, clock: Clock) -> None:
        self._open_line = open_line
        self._clock = clock
        self._line: InputLine | None = None
        self._debouncer = Debouncer(down=False)

    def wait_for_press(self, timeout_s: float | None) -> ButtonPress | None:
        """The next press once it is released, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            The line cannot be read, or the button was not entered.
        """
        line = self._opened()
        end_ns = None if timeout_s is None else self._clock.monotonic_ns() + round(timeout_s * 1e9)
        while True:
            self._catch_up(line)
            if press := self._debouncer.take():
                return press
            now_ns = self._clock.monotonic_ns()
            if end_ns is not None and now_ns >= end_ns:
                return None
            wake_ns = [at_ns for at_ns in (end_ns, self._debouncer.resting_at_ns()) if at_ns is not None]
            line.wait(max(min(wake_ns) - now_ns, 1) * 1e-9 if wake_ns else None)

    def is_down(self) -> bool:
        """Whether the button is down now."""
        return self._opened().is_active()

    def forget_presses(self) -> int:
        """Drop what was pressed while nobody waited; says how many."""
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
        """Hear every edge until now; what is quiet is settled by the line's real level, should an edge be lost."""
        while line.wait(0.0):
            for edge in line.edges():
                self._debouncer.edge(edge.at_ns, edge.active)
        self._debouncer.rest(self._clock.monotonic_ns(), line.is_active())

    def _opened(self) -> InputLine:
        if self._line is None:
            raise ButtonError("the button is not opened: enter the hardware before waiting for a press")
        return self._line
