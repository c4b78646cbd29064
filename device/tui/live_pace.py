"""How often the live picture is drawn: as often as asked, and less where the terminal cannot keep up."""

from __future__ import annotations

from typing import Final

SLOWEST_S: Final = 2.0
_LATE_SHARE: Final = 0.5
_CALM_TICKS: Final = 20


class LivePace:
    """The interval between live pictures.

    A terminal that is slow to take what is written makes the next tick late; every late tick doubles the interval, and
    after a while without one it is halved again.

    Parameters
    ----------
    interval_s : the shortest interval
    """

    def __init__(self, interval_s: float) -> None:
        self._shortest_s = interval_s
        self._interval_s = interval_s
        self._drawn_s: float | None = None
        self._calm = 0

    @property
    def interval_s(self) -> float:
        """The interval that holds now."""
        return self._interval_s

    def is_due(self, now_s: float) -> bool:
        """Whether a picture is to be drawn at this time; it is then taken to be drawn."""
        if self._drawn_s is not None and now_s - self._drawn_s < self._interval_s * (1.0 - 1e-6):
            return False
        self._drawn_s = now_s
        return True

    def tick(self, late_s: float) -> None:
        """Take note of a tick that came so late."""
        if late_s > _LATE_SHARE * self._interval_s:
            self._interval_s = min(2.0 * self._interval_s, SLOWEST_S)
            self._calm = 0
            return
        self._calm += 1
        if self._calm >= _CALM_TICKS:
            self._interval_s = max(self._interval_s / 2.0, self._shortest_s)
            self._calm = 0
