"""The start of `retroscan`: Ctrl-C ends in a sentence from the first import on."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `retroscan` in the main thread; returns the exit code.

    While its first modules are imported no part is open and nothing is stored, so that Ctrl-C ends the process at once:
    an exception inside an import can be dropped, or leave a compiled module half made.
    """
    before = signal.signal(signal.SIGINT, _end_at_once)
    try:
        from device.cli.main import main as run
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        return run(arguments)
    except KeyboardInterrupt:
        sys.stderr.write("retroscan: stopped\n")
        return 130


def _end_at_once(_number: int, _frame: object) -> None:
    os.write(2, b"retroscan: stopped\n")
    os._exit(130)
