"""Ctrl-C and termination while a program imports its first modules: they end it at once, in one sentence.

Nothing is open or half written yet, and an exception inside an import can be dropped, or leave a compiled module half
made. This module imports nothing of the project, so that it is in place before the first slow import.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

STOPPED = 130


@contextmanager
def ends_at_once(program: str) -> Iterator[None]:
    """Context in which Ctrl-C and SIGTERM end the process; outside the main thread it does nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(_number: int, _frame: FrameType | None) -> None:
        os.write(2, f"{program}: stopped\n".encode())
        os._exit(STOPPED)

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
