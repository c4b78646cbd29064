"""What the button does, one push after the other: that one began, and whether it was short or long."""

from __future__ import annotations

from contextlib import suppress
from typing import Final, Literal

from hal.errors import HalError
from hal.hardware import Hardware

LONG_PUSH_S: Final = 2.0
"""A button held this long asks for something else than a frame."""

Happening = Literal["pushed", "short", "long"]


class ButtonWatch:
    """The button of one instrument; a push that began before the watch is not told.

    began_ns : of the push that is not over; None between pushes
    """

    def __init__(self, hardware: Hardware) -> None:
        self._hardware = hardware
        self._waiting_ns: int | None = None
        self.began_ns: int | None = None

    def look(self, wait_s: float) -> Happening | None:
        """What happens within so long: a push begins, or the one that began is released or held long.

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
            self.began_ns = None
            return "long" if press.held_s >= LONG_PUSH_S else "short"
        if self._hardware.clock.monotonic_ns() - self.began_ns >= LONG_PUSH_S * 1e9:
            self.began_ns = None
            return "long"
        return None

    def is_waiting(self) -> bool:
        """Whether a push has begun that the next look will tell."""
        if self.began_ns is None and self._waiting_ns is None:
            with suppress(HalError):
                self._waiting_ns = self._hardware.button.wait_for_push(0.0)
        return self._waiting_ns is not None
