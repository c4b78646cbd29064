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
        self._told_ns: int | None = None

    def wait_for_push(self, timeout_s: float | None) -> int | None:
        """When the next press began (ns), at that moment, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            The line cannot be read; or the wait has no end, because nobody was asked to push.
        """
        while (press := self._bench.next_button_press()) and not self._is_new(press):
            self._bench.take_button_press()
        if not self._slept_until(None if press is None else press.began_ns, timeout_s):
            return None
        self._told_ns = press.began_ns if press else None
        return self._told_ns

    def wait_for_press(self, timeout_s: float | None) -> ButtonPress | None:
        """The next press once it is released, or None after `timeout_s`.

        Raises
        ------
        ButtonError
            As for `wait_for_push`.
        """
        press = self._bench.next_button_press()
        released_ns = None if press is None else press.began_ns + round(press.held_s * 1e9)
        return self._bench.take_button_press() if self._slept_until(released_ns, timeout_s) else None

    def is_down(self) -> bool:
        """Whether somebody pushes it now."""
        now_ns = self._bench.clock.monotonic_ns()
        press = self._bench.next_button_press()
        return press is not None and press.began_ns <= now_ns <= press.began_ns + round(press.held_s * 1e9)

    def forget_presses(self) -> int:
        """Drop every push that has begun; says how many `wait_for_push` had not told."""
        dropped = 0
        while (press := self._bench.next_button_press()) and press.began_ns <= self._bench.clock.monotonic_ns():
            dropped += self._is_new(self._bench.take_button_press())
        return dropped

    def _is_new(self, press: ButtonPress) -> bool:
        return self._told_ns is None or press.began_ns > self._told_ns

    def _slept_until(self, at_ns: int | None, timeout_s: float | None) -> bool:
        """Sleep until then, or for `timeout_s` when that is sooner; whether it came to that."""
        if self._bench.faults.button_unreadable:
            raise ButtonError("the twin's button cannot be read: check the line name in the board profile")
        if at_ns is None and timeout_s is None:
            raise ButtonError("nobody will push the twin's button: ask its operator for something first")
        clock = self._bench.clock
        wait_s = None if at_ns is None else (at_ns - clock.monotonic_ns()) * 1e-9
        comes = wait_s is not None and (timeout_s is None or wait_s <= timeout_s)
        clock.sleep(wait_s if comes and wait_s is not None else timeout_s or 0.0)
        return comes

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None
