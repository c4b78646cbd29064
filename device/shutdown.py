"""Termination signals handled like Ctrl-C, so that context managers run and the lights go off."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def signals_as_keyboard_interrupt(*signals: signal.Signals) -> Iterator[None]:
    """Context in which these signals raise KeyboardInterrupt.

    Only the first signal counts: a second would interrupt the clean-up that switches the lights off. Outside the main
    thread, which alone receives signals, the context does nothing.
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
