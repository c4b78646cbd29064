"""Settings of the process while it computes: one thread for matrices, and freed memory that stays.

Matrices get one thread in a program that did not ask for several before numpy was loaded.

The C library returns every large array to the system when it is freed, and the next one costs as much time as a pass
over it, for the system clears each page. A 12-megapixel scan frees a hundred fields. Only the GNU C library can be set
to keep them; with another one nothing changes.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Final

_limiting = threading.Lock()
"""Held by the call that limits: only the thread that set a limit can lift it."""


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Context in which BLAS computes on the calling thread; afterwards it has its threads back.

    Of calls that overlap on several threads the first limits, until it ends.
    """
    import scipy.linalg  # noqa: F401 - its library must be there before it can be limited
    from threadpoolctl import threadpool_limits

    if not _limiting.acquire(blocking=False):
        yield
        return
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        _limiting.release()


_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3
_MMAP_MAX: Final = -4
"""Settings of `mallopt` by their numbers in malloc.h."""

_ALWAYS: Final = {_MMAP_MAX: 0, _TRIM_THRESHOLD: 2**31 - 1}
_AFTERWARDS: Final = {_MMAP_MAX: 65536, _MMAP_THRESHOLD: 32 << 20, _TRIM_THRESHOLD: 64 << 20}
"""The default, and the thresholds that the library finds itself once a program has freed a large array."""

_lock = threading.Lock()
_users = 0


@contextmanager
def kept_memory() -> Iterator[None]:
    """Keep freed memory inside the block, in all threads; the system gets it when the last block ends.

    As a decorator it does so for each call.
    """
    library = _c_library()
    if library is None:
        yield
        return
    _begin(library)
    try:
        yield
    finally:
        _end(library)


def _begin(library: Any) -> None:
    global _users
    with _lock:
        _users += 1
        if _users == 1:
            _set(library, _ALWAYS)


def _end(library: Any) -> None:
    global _users
    with _lock:
        _users -= 1
        if _users == 0:
            _set(library, _AFTERWARDS)
            library.malloc_trim(0)


def _set(library: Any, settings: dict[int, int]) -> None:
    for setting, value in settings.items():
        library.mallopt(setting, value)


@cache
def _c_library() -> Any:
    """Return the C library, None where it has no such settings."""
    library = ctypes.CDLL(None)
    return library if hasattr(library, "mallopt") and hasattr(library, "malloc_trim") else None
