"""Interval between live pictures, adapted to the terminal."""

from __future__ import annotations

from typing import Final

MAX_INTERVAL_S: Final = 2.0

_LATE_FRACTION: Final = 0.5

_CALM_TICKS: Final = 20


class FrameRateLimiter:
    """The interval between live pictures, adapted to the terminal.

    A terminal that is slow to accept output delays the next tick; every late tick doubles the interval, and it is
    halved again after a while without one.

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
        """The present interval."""
        return self._interval_s

    def is_due(self, now_s: float) -> bool:
        """Return whether a picture is due at this time; it then counts as drawn."""
        if self._drawn_s is not None and now_s - self._drawn_s < self._interval_s * (1.0 - 1e-6):
            return False
        self._drawn_s = now_s
        return True

    def tick(self, late_s: float) -> None:
        """Record by how much a tick was late."""
        if late_s > _LATE_FRACTION * self._interval_s:
            self._interval_s = min(2.0 * self._interval_s, MAX_INTERVAL_S)
            self._calm = 0
            return
        self._calm += 1
        if self._calm >= _CALM_TICKS:
            self._interval_s = max(self._interval_s / 2.0, self._shortest_s)
            self._calm = 0
