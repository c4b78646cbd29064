"""Solves several frames of a sequence in parallel, each on a thread with its own working arrays, and returns them in
order.

Parallel over whole frames, not over stages of one: threads need not synchronize at every level of the solver and after
every kernel, and a frame's heights cannot depend on how many are solved at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from queue import SimpleQueue
from types import TracebackType
from typing import Final, Self

import numpy as np

from device.errors import DeviceError
from device.surface.fields import Float32Array
from host_sync.errors import HostError
from host_sync.frames.sequence import BadFrame, StoredFrame
from host_sync.kernels.jit import get_num_threads, set_num_threads
from host_sync.text import printable
from host_sync.video.frame_solver import FrameSolver, FrameStatistics

MAX_AT_ONCE: Final = 4
"""Maximum number of frames at once; with more threads, each frame gets several."""

MAX_PX_AT_ONCE: Final = 1 << 25
"""Maximum number of pixels at once, each with 50 to 60 bytes of working arrays; a single frame may be larger."""


@dataclass(frozen=True, slots=True)
class FrameOutcome:
    """One frame of the sequence: its statistics, or the reason why it has none."""

    name: str
    statistics: FrameStatistics | None
    reason: str | None = None


Solved = tuple[FrameOutcome, Float32Array]


class SolverPool:
    """Solvers that work on several frames at once; a context manager.

    Parameters
    ----------
    solver : the first solver; the others are its clones
    spare : number of height arrays that the caller may keep while the next frames are solved
    threads : threads in total; None for numba's setting
    max_px_at_once : maximum number of pixels at once
    """

    def __init__(
        self, solver: FrameSolver, spare: int, threads: int | None = None, max_px_at_once: int = MAX_PX_AT_ONCE
    ) -> None:
        threads, pixels = threads or get_num_threads(), solver.shape[0] * solver.shape[1]
        self._count = max(1, min(threads, MAX_AT_ONCE, max_px_at_once // pixels))
        self._solvers: SimpleQueue[FrameSolver] = SimpleQueue()
        self._solvers.put(solver)
        for _ in range(self._count - 1):
            self._solvers.put(solver.clone())
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

    def map(self, frames: Iterable[StoredFrame | BadFrame]) -> Iterator[Solved]:
        """Outcome of each frame, in order, and its heights: float32 array of shape (H, W), µm.

        Heights of a bad frame are NaN, so that every page keeps its time. Return each array with `release`.
        """
        pending: deque[Future[Solved]] = deque()
        for frame in frames:
            pending.append(self._pool.submit(self._solve, frame, self._heights.get()))
            if len(pending) > self._count:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()

    def release(self, z_um: Float32Array) -> None:
        """Return the array of a frame's heights for reuse."""
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
        message = reason if frame.name in reason else f"{frame.name}: {reason}"
        return FrameOutcome(printable(frame.name), None, printable(message)), z_um
