"""Output to a terminal that may vanish.

textual writes on a thread of its own, which an error of the terminal ends; its queue then fills up, and the program
waits for it for ever, deaf to signals. So an error is not raised: it is reported once, and later output is dropped.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO


class TerminalOutput:
    """A terminal's stream whose errors are reported once instead of being raised.

    Parameters
    ----------
    stream : of the terminal
    on_lost : called once, on whichever thread writes
    """

    def __init__(self, stream: TextIO, on_lost: Callable[[], object]) -> None:
        self._stream = stream
        self._on_lost = on_lost
        self._is_lost = False

    def write(self, text: str) -> int:
        """Write, or drop the text if the terminal is gone; returns its length."""
        if not self._is_lost:
            try:
                self._stream.write(text)
            except OSError:
                self._lose()
        return len(text)

    def flush(self) -> None:
        """Flush, unless the terminal is gone."""
        if not self._is_lost:
            try:
                self._stream.flush()
            except OSError:
                self._lose()

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """The stream's file descriptor."""
        return self._stream.fileno()

    @property
    def encoding(self) -> str:
        """Of the stream."""
        return self._stream.encoding

    def _lose(self) -> None:
        self._is_lost = True
        self._on_lost()


@contextmanager
def watched_terminal(on_lost: Callable[[], object]) -> Iterator[None]:
    """Context in which textual's terminal, the process's own standard error, is a `TerminalOutput`."""
    before = sys.__stderr__
    if before is None:
        yield
        return
    sys.__stderr__ = TerminalOutput(before, on_lost)  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        sys.__stderr__ = before  # type: ignore[misc]
