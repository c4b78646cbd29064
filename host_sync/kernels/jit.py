"""numba with its cache folder chosen first: every module of the package takes numba's functions from here.

numba reads its settings when it is imported, and would otherwise write compiled kernels beside the sources.
"""

from __future__ import annotations

from collections.abc import Callable

from host_sync.kernels.cache import configure_cache

configure_cache()

from numba import get_num_threads, njit, set_num_threads  # noqa: E402
from numba.core import event  # noqa: E402

__all__ = ["get_num_threads", "njit", "set_num_threads", "watch_compiling"]


class _Watch(event.Listener):
    """Passes on numba's events."""

    def __init__(self, begin: Callable[[], None], end: Callable[[], None]) -> None:
        self._begin = begin
        self._end = end

    def on_start(self, _: event.Event) -> None:
        self._begin()

    def on_end(self, _: event.Event) -> None:
        self._end()


def watch_compiling(begin: Callable[[], None], end: Callable[[], None]) -> None:
    """Have `begin` and `end` called around every compilation, nested ones too, in the thread that compiles."""
    event.register("numba:compile", _Watch(begin, end))  # type: ignore[no-untyped-call]
