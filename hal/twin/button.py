"""The twin's button: a view of the bench."""

from __future__ import annotations

from typing import Self

from hal.errors import ButtonError
from hal.interfaces import ButtonPress
from hal.twin.bench import Bench


class TwinButton:
    """A debounced push button; see `hal.interfaces.Button`."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def wait_for_press(self, timeout_s: float | None) -> ButtonPress | None:
        """The next press once it is released, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            The line cannot be read; or the wait has no end, because nobody was asked to push.
        """
        if self._bench.faults.button_unreadable:
            raise ButtonError("the twin's button cannot be read: check the line name in the board profile")
        clock = self._bench.clock
        press = self._bench.next_button_press()
        if press is None and timeout_s is None:
            raise ButtonError("nobody will push the twin's button: ask its operator for something first")
        if press is not None:
            wait_s = (press.began_ns - clock.monotonic_ns()) * 1e-9 + press.held_s
            if timeout_s is None or wait_s <= timeout_s:
                clock.sleep(wait_s)
                return self._bench.take_button_press()
        clock.sleep(timeout_s or 0.0)
        return None

    def is_down(self) -> bool:
        """Whether somebody pushes it now."""
        press = self._bench.next_button_press()
        return press is not None and press.began_ns <= self._bench.clock.monotonic_ns()

    def forget_presses(self) -> int:
        """Drop every push that has begun; says how many."""
        dropped = 0
        while self.is_down():
            self._bench.take_button_press()
            dropped += 1
        return dropped

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None
