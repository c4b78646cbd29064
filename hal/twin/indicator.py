"""The twin's indicator: the bench remembers what it showed."""

from __future__ import annotations

from typing import Self

from hal.interfaces import Cue
from hal.twin.bench import Bench


class TwinIndicator:
    """See `hal.interfaces.Indicator`; showing takes no time."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def show(self, cue: Cue) -> None:
        """Remember the cue and when it was shown."""
        self._bench.cues.append((self._bench.clock.monotonic_ns(), cue))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None
