"""Bands of rows that threads work on side by side.

Threads take the next band when they are done with one, so that a core that is busy with something else holds nobody up.
Kernels are compiled for one thread and release Python's lock; small fields never leave the calling thread, for to wake
another one takes longer than the work.
"""

from __future__ import annotations

from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Final

from numba import get_num_threads

SMALL_PX: Final = 1 << 17
"""Fields of fewer pixels are worked on by one thread."""

BANDS_PER_THREAD: Final = 6


def in_bands(kernel: Callable[..., object], shape: tuple[int, ...], *arguments: Any) -> None:
    """Call `kernel(*arguments, first, last)` for bands of rows that together are all rows of a field of this shape.

    Bands begin at even rows. What a kernel writes must not depend on where bands begin.
    """
    rows, threads = shape[0], get_num_threads()
    if threads == 1 or rows * shape[1] < SMALL_PX:
        kernel(*arguments, 0, rows)
        return
    pairs, count = (rows + 1) // 2, BANDS_PER_THREAD * threads
    bands: SimpleQueue[tuple[int, int]] = SimpleQueue()
    for band in range(count):
        bands.put((2 * (band * pairs // count), min(2 * ((band + 1) * pairs // count), rows)))
    others = [Thread(target=_work, args=(kernel, arguments, bands)) for _ in range(threads - 1)]
    for other in others:
        other.start()
    _work(kernel, arguments, bands)
    for other in others:
        other.join()


def _work(kernel: Callable[..., object], arguments: tuple[Any, ...], bands: SimpleQueue[tuple[int, int]]) -> None:
    """Call the kernel for one band after another until none is left."""
    while True:
        try:
            first, last = bands.get_nowait()
        except Empty:
            return
        kernel(*arguments, first, last)
