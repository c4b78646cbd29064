"""Time that a run spent compiling kernels, as numba reports it."""

from __future__ import annotations

import threading
import time

from host_sync.kernels.jit import watch_compiling


class CompileTime:
    """Counts the seconds in which at least one thread compiles; what is loaded from the cache does not count."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = 0
        self._since_s = 0.0
        self._total_s = 0.0
        watch_compiling(self._begin, self._end)

    @property
    def total_s(self) -> float:
        """Seconds so far."""
        with self._lock:
            return self._total_s + (time.monotonic() - self._since_s if self._running else 0.0)

    def _begin(self) -> None:
        with self._lock:
            self._running += 1
            if self._running == 1:
                self._since_s = time.monotonic()

    def _end(self) -> None:
        with self._lock:
            self._running -= 1
            if self._running == 0:
                self._total_s += time.monotonic() - self._since_s
