"""Tells the user once per machine that kernels are being compiled."""

from __future__ import annotations

import sys

from host_sync.kernels.cache import holds_kernels, prune_cache


def tell_of_compiling() -> None:
    """Write one line to a terminal when this run will compile; not to a log or pipe."""
    prune_cache()
    if sys.stderr.isatty() and not holds_kernels():
        sys.stderr.write("retrosync: the first run compiles for this machine and takes a minute or two longer\n")
