"""Frames of a sequence solved side by side, each on a thread and in working arrays of its own, handed over in order.

Why whole frames and not stages of one: nothing waits within a frame, for no thread has to meet another at every level
of the solver and after every kernel; and a frame's heights cannot depend on how many are solved at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from types import TracebackType
from typing import Final, Self

import numpy as np
from numba import get_num_threads, set_num_threads

from device.errors import DeviceError
from device.surface import Float32Array
from host_sync.errors import HostError
from host_sync.frame_sequence import BadFrame, StoredFrame
from host_sync.plain_text import printable
from host_sync.reconstruction.frame_solver import FrameSolver
from host_sync.reconstruction.sequence_record import FrameOutcome

MOST_AT_ONCE: Final = 4
"""Frames at once; where there are more threads, each frame has several."""

MOST_PX_AT_ONCE: Final = 1 << 25
"""Pixels at once, each of which takes 50 to 60 bytes of working arrays; one frame is solved whatever its size."""

Solved = tuple[FrameOutcome, Float32Array]


class FrameCrew:
    """Solvers that work on several frames at once; a context manager.

    Parameters
    ----------
    solver : is one of them; the others are made alike
    spare : arrays of heights that may be kept while the next frames are solved
    """

    def __init__(self, solver: FrameSolver, spare: int) -> None:
        threads, pixels = get_num_threads(), solver.shape[0] * solver.shape[1]
        self._count = max(1, min(threads, MOST_AT_ONCE, MOST_PX_AT_ONCE // pixels))
        self._solvers: SimpleQueue[FrameSolver] = SimpleQueue()
        self._solvers.put(solver)
        for _ in range(self._count - 1):
            self._solvers.put(solver.another())
        self._heights: SimpleQueue[Float32Array] = SimpleQueue()
        for _ in range(self._count + 1 + spare):
            self._heights.put(np.empty(solver.shape, np.float32))
        threads_each = -(-threads // self._count)
        self._pool = ThreadPoolExecutor(self._count, "frames", set_num_threads, (threads_each,))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(cancel_futures=True)

    def solved(self, frames: Iterable[StoredFrame | BadFrame]) -> Iterator[Solved]:
        """What became of each frame, in their order, and its heights: float32 array of shape (H, W), µm.

        Heights are NaN where a frame is bad, so that every page keeps its time. The array must be given back.
        """
        going: deque[Future[Solved]] = deque()
        for frame in frames:
            going.append(self._pool.submit(self._solve, frame, self._heights.get()))
            if len(going) > self._count:
                yield going.popleft().result()
        while going:
            yield going.popleft().result()

    def give_back(self, z_um: Float32Array) -> None:
        """Let the array of a frame's heights be filled again."""
        self._heights.put(z_um)

    def _solve(self, frame: StoredFrame | BadFrame, z_um: Float32Array) -> Solved:
        """Solve a frame into `z_um`, or fill that with NaN."""
        if isinstance(frame, StoredFrame):
            solver = self._solvers.get()
            try:
                return FrameOutcome(printable(frame.name), solver.solve(frame, z_um)), z_um
            except (DeviceError, HostError) as error:
                reason = str(error)
            finally:
                self._solvers.put(solver)
        else:
            reason = frame.reason
        z_um.fill(np.nan)
        told = reason if frame.name in reason else f"{frame.name}: {reason}"
        return FrameOutcome(printable(frame.name), None, printable(told)), z_um
