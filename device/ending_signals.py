"""Signals that end a program, turned into what Ctrl-C does: every exit is left in order and the lights go dark."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def ending_like_ctrl_c(*signals: signal.Signals) -> Iterator[None]:
    """Within it these signals end the program as Ctrl-C does: through every exit, lights dark.

    The first one counts: a second would break into the very exit that makes the lights dark. In another thread than a
    program's first, which no signal reaches, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_number: int, _frame: object) -> None:
        for number in signals:
            signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
