"""Frames in, heights out: every frame in order, several at once, or the newest one only; of a recording or a sensor.

Parallel over whole frames, not over stages of one: threads need not synchronize at every level of the solver, and a
frame's heights cannot depend on how many are solved at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Condition, Thread
from types import TracebackType
from typing import Any, Final, Self, TypeVar

import numpy as np

from device.errors import DeviceError
from device.surface import Float32Array
from hal.errors import HalError
from host_sync.errors import ArgumentError, HostError
from host_sync.frames.image_file import read_image
from host_sync.frames.sequence import DEFAULT_RATE_HZ, BadFrame, FrameSequence, StoredFrame, open_sequence
from host_sync.kernels.jit import get_num_threads, set_num_threads
from host_sync.text import printable
from host_sync.video.frame_solver import FrameSolver, FrameStatistics
from host_sync.video.sensors import Sensor, is_sensor, open_sensor

MAX_AT_ONCE: Final = 4
"""Maximum number of frames at once; with more threads, each frame gets several."""

MAX_PX_AT_ONCE: Final = 1 << 25
"""Maximum number of pixels at once, each with 50 to 60 bytes of working arrays; a single frame may be larger."""

CHECK_INTERVAL: Final = 30
"""Pattern, layout and levels are checked of one in so many frames, and of all up to the next if it does not pass."""

CLOSING_S: Final = 10.0
"""Longest wait for a source's frame when it is closed."""


@dataclass(frozen=True, slots=True, eq=False)
class SolvedFrame:
    """One frame of a source: its heights and statistics, or the reason why it has none.

    number : of the source's frames, from 0; frames that were dropped count
    height_um : float32 array of shape (H, W), zero at untouched skin, NaN where invalid and in a frame without heights
    sigma_um : standard uncertainty of the heights; None where it was not asked for
    frame : what was solved
    """

    number: int
    name: str
    height_um: Float32Array
    sigma_um: Float32Array | None
    statistics: FrameStatistics | None
    frame: StoredFrame | BadFrame
    reason: str | None = None


Outcome = TypeVar("Outcome")


def in_order(jobs: Iterable[Future[Outcome]], ahead: int) -> Iterator[Outcome]:
    """Yield the results of jobs in their order; `ahead` further ones are begun before a result is waited for.

    It ends at a job that was cancelled.
    """
    pending: deque[Future[Outcome]] = deque()
    with suppress(CancelledError):
        for job in jobs:
            pending.append(job)
            if len(pending) > ahead:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


class FrameStream:
    """Solves the frames of a source in order; a context manager.

    Parameters
    ----------
    solver : the first solver; the others are its clones
    at_once : number of frames at once; None for as many as threads and memory allow
    sigma : also find the uncertainty of heights
    """

    def __init__(self, solver: FrameSolver, at_once: int | None = None, *, sigma: bool = False) -> None:
        threads, pixels = get_num_threads(), solver.shape[0] * solver.shape[1]
        self.at_once = at_once or max(1, min(threads, MAX_AT_ONCE, MAX_PX_AT_ONCE // pixels))
        self._shape, self._sigma = solver.shape, sigma
        self._solvers: SimpleQueue[FrameSolver] = SimpleQueue()
        self._solvers.put(solver)
        for _ in range(self.at_once - 1):
            self._solvers.put(solver.clone())
        self._executor = ThreadPoolExecutor(self.at_once, "frames", set_num_threads, (-(-threads // self.at_once),))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the threads; frames that wait are not solved."""
        self._executor.shutdown(cancel_futures=True)

    def solve(self, frames: Iterable[StoredFrame | BadFrame]) -> Iterator[SolvedFrame]:
        """Yield each frame's heights in order until it is closed; `at_once` are solved ahead, none where that is 1."""
        return in_order(self._submitted(frames), 0 if self.at_once == 1 else self.at_once)

    def _submitted(self, frames: Iterable[StoredFrame | BadFrame]) -> Iterator[Future[SolvedFrame]]:
        passed: Future[bool] = Future()
        for count, frame in enumerate(frames):
            is_first = count % CHECK_INTERVAL == 0
            passed = Future() if is_first else passed
            try:
                job = self._executor.submit(self._solved, count, frame, passed, is_first)
            except RuntimeError:  # it was closed, maybe by another thread
                return
            if is_first:  # also when it is cancelled or fails, so that no other frame waits for it
                job.add_done_callback(partial(_settle, passed))
            yield job

    def _solved(self, count: int, frame: StoredFrame | BadFrame, passed: Future[bool], is_first: bool) -> SolvedFrame:
        z_um = np.empty(self._shape, np.float32)
        sigma_um = np.full(self._shape, np.nan, np.float32) if self._sigma else None
        number, reason = count if frame.number is None else frame.number, ""
        if isinstance(frame, StoredFrame):
            solver = self._solvers.get()
            try:
                if is_first or not passed.result():
                    solver.check(frame)
                if is_first:
                    passed.set_result(True)
                figures = solver.solve(frame, z_um, sigma_um)
                name = printable(frame.name)
                return SolvedFrame(number, name, z_um, sigma_um, figures, frame)
            except (DeviceError, HostError) as error:
                reason = str(error)
            finally:
                self._solvers.put(solver)
        else:
            reason = frame.reason
        z_um.fill(np.nan)
        message = printable(reason if frame.name in reason else f"{frame.name}: {reason}")
        return SolvedFrame(number, printable(frame.name), z_um, sigma_um, None, frame, message)


def _settle(passed: Future[bool], _job: Future[SolvedFrame]) -> None:
    """Record of the first of some frames that it did not pass, if nothing is recorded."""
    if not passed.done():
        passed.set_result(False)


class NewestFrames:
    """The newest frame of a source that does not wait; older ones are dropped and counted.

    A thread reads the source, so that its frames are never late. Closing ends the thread.

    frames : the source
    tap : is given every frame as it comes
    """

    def __init__(
        self, frames: Iterator[StoredFrame | BadFrame], tap: Callable[[StoredFrame | BadFrame], None] = lambda _: None
    ) -> None:
        self.dropped = self.read = 0
        self._frames, self._tap = frames, tap
        self._newest: StoredFrame | BadFrame | None = None
        self._error: BaseException | None = None
        self._ended = False
        self._changed = Condition()
        self._thread = Thread(target=self._read_all, name="newest frame", daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[StoredFrame | BadFrame]:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None or self._ended)
                frame, self._newest = self._newest, None
                if frame is None:
                    if self._error is not None:
                        raise self._error
                    return
            yield frame

    def close(self) -> None:
        """End the thread with the frame that it waits for; one that waits longer than `CLOSING_S` is left."""
        with self._changed:
            self._newest, self._ended = None, True
            self._changed.notify_all()
        self._thread.join(CLOSING_S)

    def _read_all(self) -> None:
        error = None
        try:
            for frame in self._frames:
                self._tap(frame)
                with self._changed:
                    if self._ended:
                        return
                    self.dropped += self._newest is not None
                    self.read += 1
                    self._newest = frame
                    self._changed.notify_all()
        except (HostError, DeviceError, HalError, OSError) as raised:
            error = raised
        with self._changed:
            self._error, self._ended = error, True
            self._changed.notify_all()


NS: Final = 1e-9
Tap = Callable[[StoredFrame | BadFrame], None]


class LiveHeights:
    """Solved frames of a source; an iterator that releases the source at its end, or when it is closed.

    frames : the source
    sensor : the source where it is one in real time
    newest : solve the newest frame only
    rate_hz : of a recording
    tap : is given every frame of a sensor as it comes
    """

    def __init__(
        self,
        frames: Iterator[StoredFrame | BadFrame],
        solver: FrameSolver,
        *,
        sensor: Sensor | None = None,
        newest: bool,
        sigma: bool = False,
        rate_hz: float | None = None,
        tap: Tap = lambda _: None,
    ) -> None:
        self.has_sigma = sigma
        self._sensor, self._rate_hz = sensor, rate_hz or DEFAULT_RATE_HZ
        self._stream = FrameStream(solver, 1 if newest else None, sigma=sigma)
        self._newest = NewestFrames(frames, tap) if newest else None
        self._solved = self._stream.solve(frames if self._newest is None else self._newest)
        self._began_ns: int | None = None

    @property
    def problem(self) -> str | None:
        """The sentence on a sensor that was unplugged and is looked for; None while it gives frames."""
        return None if self._sensor is None else self._sensor.problem

    @property
    def read(self) -> int:
        """Number of frames that the source has given."""
        return 0 if self._newest is None else self._newest.read

    @property
    def dropped(self) -> int:
        """Number of frames that came while another was solved."""
        return 0 if self._newest is None else self._newest.dropped

    def time_s(self, solved: SolvedFrame) -> float:
        """Return when a frame was taken, seconds from the first one on."""
        if solved.frame.taken_ns is None:
            return solved.number / self._rate_hz
        self._began_ns = solved.frame.taken_ns if self._began_ns is None else self._began_ns
        return (solved.frame.taken_ns - self._began_ns) * NS

    def __iter__(self) -> Iterator[SolvedFrame]:
        try:
            yield from self._solved
        finally:
            self.close()

    def close(self) -> None:
        """Release the source."""
        if self._sensor is not None:
            self._sensor.close()
        if self._newest is not None:
            self._newest.close()
        self._stream.close()


def open_live(
    source: int | str | Path | Iterable[Any],
    solver: FrameSolver,
    *,
    newest: bool | None = None,
    sigma: bool = False,
    tap: Tap = lambda _: None,
    report_progress: Callable[[str], None] = lambda _: None,
) -> LiveHeights:
    """Open a source as `host_sync.api.stream` takes it.

    newest : solve the newest frame only; None for a sensor's newest and every one of a recording
    tap : as of `LiveHeights`
    report_progress : is given a few words while the source is prepared

    Raises
    ------
    HostError
        It cannot be opened.
    """
    if isinstance(source, int | str | Path):
        if is_sensor(source) or newest:
            sensor = open_sensor(source, solver.shape, report_progress)
            return LiveHeights(sensor.frames(), solver, sensor=sensor, newest=newest is not False, sigma=sigma, tap=tap)
        sequence: FrameSequence = open_sequence(Path(str(source)))
        return LiveHeights(sequence.frames(), solver, newest=False, sigma=sigma, rate_hz=sequence.rate_hz)
    if not isinstance(source, Iterable):
        raise ArgumentError(f"source must be a sensor, a file, a folder or frames, not {type(source).__name__}")
    return LiveHeights(_stored(source), solver, newest=bool(newest), sigma=sigma)


def _stored(images: Iterable[Any]) -> Iterator[StoredFrame]:
    """Yield images, arrays or files, as frames.

    Raises
    ------
    ArgumentError, FrameSetError
        One is neither, or cannot be read.
    """
    for number, image in enumerate(images):
        if isinstance(image, str | Path):
            yield StoredFrame(str(image), read_image(Path(image)))
        elif isinstance(image, np.ndarray) and image.ndim == 3 and image.dtype in (np.uint8, np.uint16):
            yield StoredFrame(f"frame {number}", image)
        else:
            raise ArgumentError(f"frame {number} must be an array (H, W, 3) of uint8 or uint16, or a file")
