"""One thread for matrices while this package computes, in a program that did not ask for it before numpy was loaded.

Matrices here are small: a library's own threads cost more than they gain. On two cores that others use too, a
calibration took five times as long with them.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

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
