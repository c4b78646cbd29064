"""Bands of rows that threads process in parallel.

A thread takes the next band when it has finished one, so a core that is busy elsewhere delays nothing. Kernels are
single-threaded and release the interpreter lock. Small fields stay on the calling thread, since waking another takes
longer than the work.

Threads are kept: starting one per call costs more than the work of a coarse level. A thread that has not woken before
all bands are taken is not waited for.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from queue import Empty, SimpleQueue
from typing import Any, Final, Generic, TypeVar

from host_sync.kernels.jit import get_num_threads, set_num_threads

SMALL_PX: Final = 1 << 17
"""Fields with fewer pixels are processed by one thread."""

BANDS_PER_THREAD: Final = 6

Result = TypeVar("Result")


def parallel_rows(kernel: Callable[..., object], shape: tuple[int, ...], *arguments: Any) -> None:
    """Call `kernel(*arguments, first, last)` for bands that together cover all rows of a field of this shape.

    Bands begin at even rows. What a kernel writes must not depend on where bands begin. The number of threads is what
    `numba.set_num_threads` set in the calling thread.
    """
    rows = shape[0]
    threads = 1 if rows * shape[1] < SMALL_PX else get_num_threads()
    if threads == 1:
        kernel(*arguments, 0, rows)
        return
    pairs, count = (rows + 1) // 2, BANDS_PER_THREAD * threads
    bands: SimpleQueue[tuple[int, int]] = SimpleQueue()
    for band in range(count):
        bands.put((2 * (band * pairs // count), min(2 * ((band + 1) * pairs // count), rows)))
    helpers = _helpers(os.getpid())
    jobs = [helpers.submit(_work, kernel, arguments, bands) for _ in range(threads - 1)]
    try:
        _work(kernel, arguments, bands)
    finally:
        for job in jobs:
            if not job.cancel():
                job.result()


class BackgroundCall(Generic[Result]):
    """A call that runs on another thread while the caller continues, for work that cannot be split into rows.

    It uses one thread. If the caller itself has only one, the call runs when it is started.
    """

    def __init__(self, function: Callable[..., Result], *arguments: Any) -> None:
        self._call: Callable[[], Result] = partial(function, *arguments)
        self._wait: Callable[[], Result] | None = None

    def start(self) -> Callable[[], Result]:
        """Start the call unless it was started before; returns a function that waits for the result."""
        if self._wait is None:
            self._wait = self._submit()
        return self._wait

    def result(self) -> Result:
        """Return the result of the function; waits for it."""
        return self.start()()

    def _submit(self) -> Callable[[], Result]:
        if get_num_threads() > 1:
            return _helpers(os.getpid()).submit(_run_single_threaded, self._call).result
        result = self._call()
        return lambda: result


def _run_single_threaded(call: Callable[[], Result]) -> Result:
    set_num_threads(1)
    return call()


@cache
def _helpers(_process: int) -> ThreadPoolExecutor:
    """Return threads of a process; a forked process has none of its parent's and gets new ones."""
    return ThreadPoolExecutor(os.cpu_count(), "rows")


def _work(kernel: Callable[..., object], arguments: tuple[Any, ...], bands: SimpleQueue[tuple[int, int]]) -> None:
    """Call the kernel for one band after another until none is left."""
    while True:
        try:
            first, last = bands.get_nowait()
        except Empty:
            return
        kernel(*arguments, first, last)
