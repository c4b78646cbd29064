"""Says, once on every machine, that kernels are being compiled."""

from __future__ import annotations

import sys

from host_sync.kernel_cache import forget_unused_states


def compiled_before() -> bool:
    """Whether the cache on disk holds the kernels of an earlier run."""
    from host_sync.reconstruction.rest_level import cache_directory

    return any(cache_directory().glob("rest_level.*.nbi"))


def tell_of_compiling() -> None:
    """Write one line to a terminal when this run will compile; a log or a pipe is spared it."""
    forget_unused_states()
    if sys.stderr.isatty() and not compiled_before():
        sys.stderr.write("retrosync: the first run compiles for this machine and takes a minute or two longer\n")
