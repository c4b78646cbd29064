"""Work for processes that are to die of it, as a crash or the system's shortage of memory ends them."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class DieOnce:
    """Kills the process that calls it with words that end so, the first time; further calls do nothing.

    marker : a file that is made by the first call
    """

    marker: Path
    words: str

    def __call__(self, words: str) -> None:
        if words.endswith(self.words):
            try:
                self.marker.touch(exist_ok=False)
            except FileExistsError:
                return
            os.kill(os.getpid(), signal.SIGKILL)


@dataclass(frozen=True)
class Squares:
    """Squares numbers; notes each beginning in a file, dies once at the numbers in `deadly`, always at `fatal`."""

    folder: Path
    deadly: tuple[int, ...] = ()
    fatal: tuple[int, ...] = ()

    def __call__(self) -> Callable[[int], int]:
        return self._square

    def _square(self, number: int) -> int:
        with (self.folder / "begun").open("a") as stream:
            stream.write(f"{number}\n")
        if number in self.fatal:
            os.kill(os.getpid(), signal.SIGKILL)
        if number in self.deadly:
            DieOnce(self.folder / f"died-{number}", "")("")
        return number * number


class Environment:
    """Tells what a process computes with."""

    def __call__(self) -> Callable[[str], str | None]:
        return os.environ.get
