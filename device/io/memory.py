"""Memory that was freed, given back to the system."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress


def give_back_memory() -> None:
    """Give freed memory back, after work whose intermediate fields are large; nothing where libc cannot.

    Without it the GNU libc keeps tens of megabytes of every thread's freed fields.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)
