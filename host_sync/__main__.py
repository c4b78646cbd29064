"""The start of `retrosync` and of `python -m host_sync`: Ctrl-C ends in a sentence from the first import on."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from device.shutdown import STOPPED, ends_at_once


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `retrosync`; returns the exit code."""
    with ends_at_once("retrosync"):
        from host_sync.cli.main import main as run
    try:
        return run(arguments)
    except KeyboardInterrupt:
        sys.stderr.write("retrosync: stopped\n")
        return STOPPED


if __name__ == "__main__":
    sys.exit(main())
