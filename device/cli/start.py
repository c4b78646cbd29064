"""The start of `retroscan`: Ctrl-C ends in a sentence from the first import on."""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `retroscan`; returns the exit code."""
    try:
        from device.cli.main import main as run

        return run(arguments)
    except KeyboardInterrupt:
        sys.stderr.write("retroscan: stopped\n")
        return 130
