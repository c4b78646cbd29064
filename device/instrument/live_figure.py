"""A figure of every live frame that a screen asks for, such as the focus; it ends by itself after a while."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal

from device.imaging.exposure import SkinLevels
from device.imaging.focus import FocusMeter, FocusReading
from device.instrument.events import Info
from device.instrument.live import LiveFrame, LiveLoop
from device.instrument.state import StateStore
from hal.frame import RawFrame
from hal.interfaces import Clock

MAX_READING_S: Final = 600.0
"""Maximum time: the lights stay on meanwhile, which warms the gel."""

Read = Callable[[RawFrame], FocusReading | SkinLevels]


class LiveFigure:
    """Reads a figure of live frames between `start` and `stop`; for the hardware's thread only.

    Parameters
    ----------
    field : of the state, where the figure is shown
    begin : returns what reads frames; called at every start
    ended : what is said when it ends by itself
    """

    def __init__(
        self,
        states: StateStore,
        live: LiveLoop,
        clock: Clock,
        field: Literal["focus", "levels"],
        begin: Callable[[], Read],
        ended: str,
    ) -> None:
        self._states = states
        self._live = live
        self._clock = clock
        self._field = field
        self._begin = begin
        self._ended = ended
        self._read: Read | None = None
        self._started_ns = 0

    def start(self) -> None:
        """Read from now on; what was seen before is forgotten."""
        self._read, self._started_ns = self._begin(), self._clock.monotonic_ns()
        self._live.wake()

    def stop(self) -> None:
        """Read no longer."""
        self._read = None
        self._states.update(**{self._field: None})

    def step(self, live: LiveFrame | None) -> None:
        """Read a live frame, if the figure is wanted and there is one."""
        if self._read is None:
            return
        if self._clock.monotonic_ns() - self._started_ns > MAX_READING_S * 1e9:
            self.stop()
            self._states.publish(Info(f"{self._ended} ended after {MAX_READING_S / 60.0:.0f} minutes."))
            return
        self._live.wake()
        if live is not None:
            self._states.update(**{self._field: self._read(live.frame)})


def focus_figure_of(states: StateStore, live: LiveLoop, clock: Clock) -> LiveFigure:
    """Return how sharp the lens is set, while a person turns it."""
    return LiveFigure(states, live, clock, "focus", lambda: FocusMeter().read, "The focus figure")


def skin_levels_of(states: StateStore, live: LiveLoop, clock: Clock) -> LiveFigure:
    """Return how bright each light is on the skin."""
    return LiveFigure(states, live, clock, "levels", lambda: SkinLevels.of_frame, "Reading the light on the skin")
