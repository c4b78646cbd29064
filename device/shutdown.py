"""An orderly end: termination signals are handled like Ctrl-C, so that context managers run and the lights go off."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from sys import UnraisableHookArgs


AGAIN_S: Final = 0.05
"""An interrupt that cannot be raised now is tried again after this."""

_IMPORT: Final = "<frozen importlib._bootstrap>"


@contextmanager
def signals_as_keyboard_interrupt(*signals: signal.Signals) -> Iterator[None]:
    """Context in which these signals raise KeyboardInterrupt.

    Only the first signal counts: a second would interrupt the clean-up that switches the lights off. It is raised after
    an import in progress, which may not survive it, and again where Python had to drop it, in a destructor or callback.
    Outside the main thread, which alone receives signals, the context does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    is_due = False

    def interrupt(_number: int, frame: FrameType | None) -> None:
        nonlocal is_due
        if _is_importing(frame):
            raise_soon()
            return
        is_due = False
        for number in signals:
            signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    def raise_soon() -> None:
        nonlocal is_due
        if not is_due:
            is_due = True
            threading.Thread(target=send_until_raised, daemon=True).start()

    def send_until_raised() -> None:
        # A true signal, since the main thread may wait in the system; one that comes just before it is heard late.
        time.sleep(AGAIN_S)
        while is_due:
            os.kill(os.getpid(), signals[0])
            time.sleep(AGAIN_S)

    def unraisable(dropped: UnraisableHookArgs) -> None:
        if dropped.exc_type is KeyboardInterrupt:
            signal.signal(signals[0], interrupt)
            raise_soon()
        else:
            hook_before(dropped)

    hook_before, sys.unraisablehook = sys.unraisablehook, unraisable
    before = {number: signal.signal(number, interrupt) for number in signals}
    try:
        yield
    finally:
        is_due = False
        for number, handler in before.items():
            signal.signal(number, handler)
        sys.unraisablehook = hook_before


def _is_importing(frame: FrameType | None) -> bool:
    """Return whether a frame runs within an import."""
    while frame is not None:
        if frame.f_code.co_filename == _IMPORT:
            return True
        frame = frame.f_back
    return False


# Ctrl-C and termination while a program imports its first modules: they end it at once, in one sentence.
#
# Nothing is open or half written yet, and an exception inside an import can be dropped, or leave a compiled module half
# made. This module imports nothing of the project, so that it is in place before the first slow import.

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
