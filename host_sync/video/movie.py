"""Movie of the relief of a sequence whose heights are on disk: one colour range, shading and layout for all frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from device.surface import Float32Array, HeightMap
from host_sync.render.picture_file import MAX_RATE_HZ, ReliefGif, ReliefMovie
from host_sync.render.relief_sheet import ReliefSheet
from host_sync.render.shading import Picture, exaggeration_for, height_range_um, reduced, steep_slope

MOVIE_WIDTH_PX: Final = 960
Progress = Callable[[str, int, int], None]

_MAX_QUEUED: Final = 3
"""Number of pictures drawn ahead of the encoder."""


@dataclass(slots=True)
class RenderedRelief:
    """Height range of a sequence, µm, and the steepest of its frames' slopes, collected frame by frame."""

    low_um: float = float("inf")
    high_um: float = float("-inf")
    steep: float = 0.0

    def add(self, height: HeightMap) -> None:
        """Include a frame's heights."""
        low_um, high_um = height_range_um(height)
        self.low_um, self.high_um = min(self.low_um, low_um), max(self.high_um, high_um)
        self.steep = max(self.steep, steep_slope(height))


@dataclass(frozen=True, slots=True)
class MovieFiles:
    """Movie files to write; None for none."""

    mp4: Path | None
    gif: Path | None
    webp: Path | None = None

    @property
    def small(self) -> tuple[Path, ...]:
        """The files of fewer and smaller pictures."""
        return tuple(path for path in (self.gif, self.webp) if path is not None)

    @property
    def wanted(self) -> bool:
        """True if any movie is to be drawn."""
        return self.mp4 is not None or bool(self.small)


def write_movie(
    files: MovieFiles,
    stack: Float32Array,
    pitch_um: float,
    rate_hz: float,
    relief: RenderedRelief,
    title: str,
    progress: Progress,
) -> None:
    """Draw and encode the relief of every page.

    stack : float32 array of shape (T, H, W), µm; pages are read as they are drawn
    progress : called with the step, pages done and pages in total

    Raises
    ------
    ResultError, OSError
        A movie cannot be written.
    """
    skipped = max(1, int(np.ceil(rate_hz / MAX_RATE_HZ)))
    numbers = range(0, len(stack), skipped)
    first = _page(stack, 0, pitch_um)
    sheet = ReliefSheet(
        first.z_um.shape, first.pitch_um, (relief.low_um, relief.high_um), exaggeration_for(relief.steep), title
    )
    gif = ReliefGif(len(numbers), rate_hz / skipped) if files.small else None
    with ExitStack() as opened:
        sinks: list[Callable[[int, Picture], None]] = [gif.append] if gif else []
        if files.mp4:
            movie = opened.enter_context(ReliefMovie(files.mp4, sheet.shape, rate_hz / skipped))
            sinks.append(lambda _index, picture: movie.append(picture))
        # Entered last, so that encoding has ended when the movie is closed.
        encoder = opened.enter_context(ThreadPoolExecutor(1))
        pending: deque[Future[None]] = deque()
        for index, number in enumerate(numbers):
            picture = sheet.draw(_page(stack, number, pitch_um), f"{number / rate_hz:.2f} s")
            pending.extend(encoder.submit(sink, index, picture) for sink in sinks)
            while len(pending) > _MAX_QUEUED:
                pending.popleft().result()
            progress("relief", number + 1, len(stack))
        for job in pending:
            job.result()
    if gif is not None:
        for path in files.small:
            gif.write(path)


def _page(stack: Float32Array, number: int, pitch_um: float) -> HeightMap:
    """Return a page, reduced to the movie's size."""
    return reduced(HeightMap(np.array(stack[number], np.float32), pitch_um), MOVIE_WIDTH_PX)
