"""`retrosync reconstruct --watch`: reconstructs and measures whatever a pull brings."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from host_sync.cli.calibrator import calibrator_for
from host_sync.cli.console import DONE, PARTLY, print_error, print_line, status_spinner, tell_of_compiling
from host_sync.cli.measure import chosen_recipe
from host_sync.library.library import Library, default_library

if TYPE_CHECKING:
    from host_sync.batch.library_watch import LibraryWatch


MAX_EVERY_S: Final = 86_400.0
"""A day."""


def watch_library(library: Path | None, recipe: Path | None, workers: int | None, every_s: float, *, once: bool) -> int:
    """Reconstruct and measure whatever comes into a library, until it is stopped; returns the exit code.

    Arguments as of `retrosync reconstruct --watch`.
    """
    held = Library(library or default_library())
    held.require()
    chosen = chosen_recipe(recipe, {})
    with status_spinner() as tell:
        tell("loading compiled code")
        tell_of_compiling()
        from host_sync.batch.library_watch import LibraryWatch, only_watch
        from host_sync.reconstruction.from_library import LibraryReconstructor

        job = LibraryReconstructor(held, tell=tell, calibrator=calibrator_for(None, tell))
        watch = LibraryWatch(held, job, chosen, workers, tell)
        with only_watch(held):
            while True:
                failed = _look(watch)
                if once:
                    return PARTLY if failed else DONE
                tell("waiting for scans")
                time.sleep(every_s)


def _look(watch: LibraryWatch) -> bool:
    """Do what there is to do, with a line for every scan; returns whether one failed."""
    failed = False
    for outcome in watch.look():
        if outcome.reason is not None:
            failed = True
            print_error(f"{outcome.scan}: {outcome.reason}", PARTLY)
        else:
            print_line(f"{outcome.folder}")
        for words in outcome.warnings:
            print_error(f"{outcome.scan}: doubt: {words}", PARTLY)
        sys.stdout.flush()
    return failed
