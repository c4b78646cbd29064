"""Work that an interpreter leaves to the system when it ends.

At its end it collects what refers to itself, record types too, in any order: msgspec 0.22 may then free what is gone
already, so that a program which has done its work dies of a segmentation fault (msgspec issue 717; in 5 of 25 runs of a
script that reconstructs a scan). What the collector does not look at goes with the process. To be deleted once msgspec
mends that.
"""

from __future__ import annotations

import atexit
import gc


def leave_cycles_to_the_system() -> None:
    """Keep the collector from everything that is left when the interpreter ends."""
    atexit.register(gc.freeze)
