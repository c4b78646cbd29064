"""Pushes of the button, short and long, and what a long push does without a screen."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Final, Literal

from device.instrument.events import Info
from device.instrument.state import StateStore, status_summary
from hal.errors import HalError
from hal.hardware import Hardware
from hal.interfaces import Clock

LONG_PUSH_S: Final = 2.0
"""A push held at least this long is a long push, which takes no scan."""

OFF_PUSH_S: Final = 6.0
"""A push held on for this long powers off, without a screen."""

ButtonEvent = Literal["pushed", "short", "long", "off"]


AGAIN_S: Final = 10.0
"""A second long push within this time starts a calibration."""


class ButtonWatch:
    """The button of one instrument; a push that began earlier is not reported.

    began_ns : start of the current push; None between pushes
    """

    def __init__(self, hardware: Hardware) -> None:
        self._hardware = hardware
        self._waiting_ns: int | None = None
        self._is_long = False
        self.began_ns: int | None = None

    def wait(self, wait_s: float) -> ButtonEvent | None:
        """Return the next event within `wait_s`: a push begins, is released, is held long, or is held until power off.

        Raises
        ------
        ButtonError
            The button cannot be read.
        """
        button = self._hardware.button
        if self.began_ns is None:
            self.began_ns, self._waiting_ns = self._waiting_ns or button.wait_for_push(wait_s), None
            return None if self.began_ns is None else "pushed"
        if press := button.wait_for_press(wait_s):
            was_long, self.began_ns, self._is_long = self._is_long, None, False
            if was_long:
                return None
            return "long" if press.held_s >= LONG_PUSH_S else "short"
        held_s = (self._hardware.clock.monotonic_ns() - self.began_ns) * 1e-9
        if self._is_long and held_s >= OFF_PUSH_S:
            self.forget()
            return "off"
        if not self._is_long and held_s >= LONG_PUSH_S:
            self._is_long = True
            return "long"
        return None

    def forget(self) -> bool:
        """Forget the current push, whose release may never be seen; returns whether it had no event but "pushed"."""
        was_open = self.began_ns is not None and not self._is_long
        self._waiting_ns = self.began_ns = None
        self._is_long = False
        return was_open

    def is_waiting(self) -> bool:
        """Return whether a push has begun that the next `wait` will report."""
        if self.began_ns is None and self._waiting_ns is None:
            with suppress(HalError):
                self._waiting_ns = self._hardware.button.wait_for_push(0.0)
        return self._waiting_ns is not None


class LongPressHandler:
    """Long pushes without a screen: the first opens the pairing window, a second soon after starts a calibration.

    Parameters
    ----------
    open_pairing : called after the first, and after each one while a code waits for its confirmation
    confirms : True while such a code is shown
    calibrate : called after the second
    """

    def __init__(
        self,
        states: StateStore,
        clock: Clock,
        open_pairing: Callable[[], None],
        calibrate: Callable[[], None],
        confirms: Callable[[], bool],
    ) -> None:
        self._states = states
        self._clock = clock
        self._open_pairing = open_pairing
        self._calibrate = calibrate
        self._confirms = confirms
        self._before_ns: int | None = None

    def on_long_press(self) -> None:
        """Report the instrument's status and open the pairing window; soon after another one, calibrate.

        While a code is shown, confirm it.
        """
        if self._confirms():
            self._open_pairing()
            return
        now_ns, before_ns = self._clock.monotonic_ns(), self._before_ns
        if before_ns is not None and now_ns - before_ns <= AGAIN_S * 1e9:
            self._before_ns = None
            self._calibrate()
            return
        self._before_ns = now_ns
        self._states.publish(Info(f"Held {LONG_PUSH_S:.0f} s, no scan.{status_summary(self._states.state)}"))
        self._open_pairing()
