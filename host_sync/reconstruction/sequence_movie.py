"""The moving relief of a sequence whose heights are on disk: one colour range, one shading, one layout throughout."""

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
from host_sync.render.relief import Picture, height_range_um
from host_sync.render.relief_movie import MOST_RATE_HZ, ReliefGif, ReliefMovie
from host_sync.render.relief_sheet import ReliefSheet
from host_sync.render.shading import exaggeration_for, reduced, steep_slope

MOVIE_WIDEST_PX: Final = 960
Progress = Callable[[str, int, int], None]

_AHEAD: Final = 3
"""Pictures drawn before the encoder has taken the first of them."""


@dataclass(slots=True)
class SeenRelief:
    """What the heights of a sequence span, gathered frame by frame; µm, and the steepest of its frames' slopes."""

    low_um: float = float("inf")
    high_um: float = float("-inf")
    steep: float = 0.0

    def add(self, height: HeightMap) -> None:
        """Take a frame's heights into account."""
        low_um, high_um = height_range_um(height)
        self.low_um, self.high_um = min(self.low_um, low_um), max(self.high_um, high_um)
        self.steep = max(self.steep, steep_slope(height))


@dataclass(frozen=True, slots=True)
class MovieFiles:
    """What is wanted of the moving relief."""

    mp4: Path | None
    gif: Path | None

    @property
    def wanted(self) -> bool:
        """Whether there is anything to draw."""
        return self.mp4 is not None or self.gif is not None


def write_movie(
    files: MovieFiles,
    stack: Float32Array,
    pitch_um: float,
    rate_hz: float,
    seen: SeenRelief,
    title: str,
    progress: Progress,
) -> None:
    """Draw and encode the relief of every page.

    stack : float32 array of shape (T, H, W), µm; pages are read as they are drawn
    progress : is given the step, and how many pages of how many are done

    Raises
    ------
    ResultError, OSError
        A movie cannot be written.
    """
    skipped = max(1, int(np.ceil(rate_hz / MOST_RATE_HZ)))
    numbers = range(0, len(stack), skipped)
    first = _page(stack, 0, pitch_um)
    sheet = ReliefSheet(
        first.z_um.shape, first.pitch_um, (seen.low_um, seen.high_um), exaggeration_for(seen.steep), title
    )
    gif = ReliefGif(len(numbers), rate_hz / skipped) if files.gif else None
    with ExitStack() as opened:
        sinks: list[Callable[[int, Picture], None]] = [gif.append] if gif else []
        if files.mp4:
            movie = opened.enter_context(ReliefMovie(files.mp4, sheet.shape, rate_hz / skipped))
            sinks.append(lambda _order, picture: movie.append(picture))
        # Entered last, so that nothing is being encoded any more when the movie is closed.
        encoder = opened.enter_context(ThreadPoolExecutor(1))
        pending: deque[Future[None]] = deque()
        for order, number in enumerate(numbers):
            picture = sheet.draw(_page(stack, number, pitch_um), f"{number / rate_hz:.2f} s")
            pending.extend(encoder.submit(sink, order, picture) for sink in sinks)
            while len(pending) > _AHEAD:
                pending.popleft().result()
            progress("relief", number + 1, len(stack))
        for job in pending:
            job.result()
    if gif and files.gif:
        gif.write(files.gif)


def _page(stack: Float32Array, number: int, pitch_um: float) -> HeightMap:
    """A page, reduced to the movie's size."""
    return reduced(HeightMap(np.array(stack[number], np.float32), pitch_um), MOVIE_WIDEST_PX)
