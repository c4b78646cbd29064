"""What a button that is held long asks for where no screen leads: a workstation may come; held again, a calibration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from device.session.button_watch import LONG_PUSH_S
from device.session.described import standing
from device.session.events import Told
from device.session.noticeboard import Noticeboard
from hal.interfaces import Clock

AGAIN_S: Final = 10.0
"""A long push so soon after another asks for a calibration."""


class LongPush:
    """Long pushes of one instrument.

    Parameters
    ----------
    open_pairing : what one asks for
    calibrate : what a second asks for
    """

    def __init__(
        self, board: Noticeboard, clock: Clock, open_pairing: Callable[[], None], calibrate: Callable[[], None]
    ) -> None:
        self._board = board
        self._clock = clock
        self._open_pairing = open_pairing
        self._calibrate = calibrate
        self._before_ns: int | None = None

    def happened(self) -> None:
        """Say how things stand and open the pairing window; soon after another, calibrate."""
        now_ns, before_ns = self._clock.monotonic_ns(), self._before_ns
        if before_ns is not None and now_ns - before_ns <= AGAIN_S * 1e9:
            self._before_ns = None
            self._calibrate()
            return
        self._before_ns = now_ns
        self._board.tell(Told(f"Held {LONG_PUSH_S:.0f} s, no scan.{standing(self._board.state)}"))
        self._open_pairing()
