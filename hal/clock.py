"""Clocks: the system clock, and a virtual one that advances only in `sleep`."""

from __future__ import annotations

import time

_NS_PER_S = 1_000_000_000


class SystemClock:
    """The system clock."""

    def monotonic_ns(self) -> int:
        """Return monotonic time, ns."""
        return time.monotonic_ns()

    def wall_time_s(self) -> float:
        """Return seconds since 1970 by the system clock."""
        return time.time()

    def sleep(self, duration_s: float) -> None:
        """Return after `duration_s` seconds."""
        time.sleep(max(duration_s, 0.0))


class VirtualClock:
    """A clock that advances only in `sleep`, so that hours take no time and runs repeat exactly.

    Parameters
    ----------
    start_ns : monotonic time at the beginning, ns
    wall_start_s : wall time at the beginning, seconds since 1970
    """

    def __init__(self, start_ns: int = 0, wall_start_s: float = 0.0) -> None:
        self._start_ns = start_ns
        self._now_ns = start_ns
        self._wall_start_s = wall_start_s

    def monotonic_ns(self) -> int:
        """Return nanoseconds of virtual time."""
        return self._now_ns

    def wall_time_s(self) -> float:
        """Return seconds since 1970, advancing with the virtual time."""
        return self._wall_start_s + (self._now_ns - self._start_ns) / _NS_PER_S

    def jump_wall(self, by_s: float) -> None:
        """Set the wall clock by that much, as a person or a time server does; monotonic time goes on."""
        self._wall_start_s += by_s

    def sleep(self, duration_s: float) -> None:
        """Advance by `duration_s` seconds at once, by at least 1 ns when it is positive."""
        if duration_s > 0.0:
            self._now_ns += max(round(duration_s * _NS_PER_S), 1)
