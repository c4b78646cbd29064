"""`retrosync watch`: reconstructs and measures whatever a pull brings."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter
from cyclopts.validators import Number

from device.command_line import Folder
from host_sync.cli.calibrator import calibrator_for
from host_sync.cli.console import DONE, PARTLY, print_error, print_line, status_spinner, tell_of_compiling
from host_sync.cli.measure import chosen_recipe
from host_sync.library.library import Library, default_library

if TYPE_CHECKING:
    from host_sync.batch.library_watch import LibraryWatch


MAX_EVERY_S: Final = 86_400.0
"""A day."""


def watch_command(
    library: Folder | None = None,
    *,
    recipe: Path | None = None,
    workers: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    every_s: Annotated[float, Parameter(validator=Number(gt=0, lte=MAX_EVERY_S))] = 5.0,
    once: bool = False,
) -> int:
    """Reconstruct and measure whatever comes into a library, until it is stopped.

    Measurements go to measurements/SCAN.json in the library. What is already done is not done again.

    Parameters
    ----------
    library
        Folder of pulled scans; ~/Retrograph by default.
    recipe
        TOML file of the measurement recipe.
    workers
        Scans at a time, as for `retrosync reconstruct`.
    every_s
        Look for new scans so many seconds after the last look's work is done; at most a day.
    once
        Do what there is to do now, and end: exit code 1 when a scan failed.
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
