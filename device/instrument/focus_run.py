"""The live focus figure: every live frame is read while a person turns the lens; it ends by itself after a while."""

from __future__ import annotations

from typing import Final

from device.imaging.focus import FocusMeter
from device.instrument.events import Info
from device.instrument.live import LiveFrame, LiveLoop
from device.instrument.state import StateStore
from hal.interfaces import Clock

MAX_FOCUS_S: Final = 600.0
"""Maximum time: the lights stay on meanwhile, which warms the gel."""


class FocusRun:
    """Reads the focus of live frames between `start` and `stop`; for the hardware's thread only."""

    def __init__(self, states: StateStore, live: LiveLoop, clock: Clock) -> None:
        self._states = states
        self._live = live
        self._clock = clock
        self._meter: FocusMeter | None = None
        self._started_ns = 0

    def start(self) -> None:
        """Read from now on; the best figure starts anew."""
        self._meter, self._started_ns = FocusMeter(), self._clock.monotonic_ns()
        self._live.wake()

    def stop(self) -> None:
        """Read no longer."""
        self._meter = None
        self._states.update(focus=None)

    def step(self, live: LiveFrame | None) -> None:
        """Read a live frame, if the focus is wanted and there is one."""
        if self._meter is None:
            return
        if self._clock.monotonic_ns() - self._started_ns > MAX_FOCUS_S * 1e9:
            self.stop()
            self._states.publish(Info(f"The focus figure ended after {MAX_FOCUS_S / 60.0:.0f} minutes."))
            return
        self._live.wake()
        if live is not None:
            self._states.update(focus=self._meter.read(live.frame))
