"""Bands of rows that threads work on side by side.

Threads take the next band when they are done with one, so that a core that is busy with something else holds nobody up.
Kernels are compiled for one thread and release Python's lock; small fields never leave the calling thread, for to wake
another one takes longer than the work.

Why helpers are kept: a thread that is started for every call costs the caller more than the work of a coarse level, and
it must be waited for twice. A helper that has not woken before the bands are gone is not waited for at all.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from queue import Empty, SimpleQueue
from typing import Any, Final, Generic, TypeVar

from numba import get_num_threads, set_num_threads

SMALL_PX: Final = 1 << 17
"""Fields of fewer pixels are worked on by one thread."""

BANDS_PER_THREAD: Final = 6

Argument = TypeVar("Argument")
Result = TypeVar("Result")


def in_bands(kernel: Callable[..., object], shape: tuple[int, ...], *arguments: Any) -> None:
    """Call `kernel(*arguments, first, last)` for bands of rows that together are all rows of a field of this shape.

    Bands begin at even rows. What a kernel writes must not depend on where bands begin. As many threads work as
    `numba.set_num_threads` lets the calling one have.
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


class Beside(Generic[Result]):
    """A call that a helper makes while the caller goes on: for work that is not needed at once and fits no bands.

    The helper works on one thread. Where the caller has but one itself, the call is made when it is begun.
    """

    def __init__(self, function: Callable[[Argument], Result], argument: Argument) -> None:
        self._call: Callable[[], Result] = partial(function, argument)
        self._wait: Callable[[], Result] | None = None

    def begin(self) -> Callable[[], Result]:
        """Begin, unless that was done before; returns what waits for the result."""
        if self._wait is None:
            self._wait = self._begun()
        return self._wait

    def result(self) -> Result:
        """What the function returned, as soon as it has."""
        return self.begin()()

    def _begun(self) -> Callable[[], Result]:
        if get_num_threads() > 1:
            return _helpers(os.getpid()).submit(_alone, self._call).result
        result = self._call()
        return lambda: result


def _alone(call: Callable[[], Result]) -> Result:
    set_num_threads(1)
    return call()


@cache
def _helpers(_process: int) -> ThreadPoolExecutor:
    """The helpers of a process; one that was forked has no threads but its own, and gets others."""
    return ThreadPoolExecutor(os.cpu_count(), "rows")


def _work(kernel: Callable[..., object], arguments: tuple[Any, ...], bands: SimpleQueue[tuple[int, int]]) -> None:
    """Call the kernel for one band after another until none is left."""
    while True:
        try:
            first, last = bands.get_nowait()
        except Empty:
            return
        kernel(*arguments, first, last)
