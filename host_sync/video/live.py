"""Heights of a source while it runs: opens it, solves its newest or every frame, records on request."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from host_sync.errors import ArgumentError
from host_sync.frames.image_file import read_image
from host_sync.frames.sequence import DEFAULT_RATE_HZ, BadFrame, FrameSequence, StoredFrame, open_sequence
from host_sync.video.frame_solver import FrameSolver
from host_sync.video.sensors import Sensor, is_sensor, open_sensor
from host_sync.video.stream import FrameStream, NewestFrames, SolvedFrame

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
        self.problem: str | None = None
        self.has_sigma = sigma
        self._sensor, self._rate_hz = sensor, rate_hz or DEFAULT_RATE_HZ
        if sensor is not None:
            sensor.tell = self._set_problem
        self._stream = FrameStream(solver, 1 if newest else None, sigma=sigma)
        self._newest = NewestFrames(frames, tap) if newest else None
        self._solved = self._stream.solve(frames if self._newest is None else self._newest)
        self._began_ns: int | None = None

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

    def _set_problem(self, problem: str | None) -> None:
        self.problem = problem


def open_live(
    source: int | str | Path | Iterable[Any],
    solver: FrameSolver,
    *,
    newest: bool | None = None,
    sigma: bool = False,
    tap: Tap = lambda _: None,
    tell: Callable[[str], None] = lambda _: None,
) -> LiveHeights:
    """Open a source as `host_sync.api.stream` takes it.

    newest : solve the newest frame only; None for a sensor's newest and every one of a recording
    tap : as of `LiveHeights`
    tell : is given a few words while the source is prepared

    Raises
    ------
    HostError
        It cannot be opened.
    """
    if isinstance(source, int | str | Path):
        if is_sensor(source) or newest:
            sensor = open_sensor(source, solver.shape, tell)
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
