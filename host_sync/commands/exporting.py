"""`retrosync export`: a scan in the files that other programs open."""

from __future__ import annotations

from typing import Annotated

from cyclopts import App, Parameter

from host_sync.commands.console import DONE, Folder, say
from host_sync.export.raw_scan import RawFormat, export_raw
from host_sync.library import Library, default_library


def register(app: App) -> None:
    """Add the command."""
    app.command(export_command, name="export")


def export_command(
    scan: str,
    *,
    to: Annotated[tuple[RawFormat, ...], Parameter(consume_multiple=True)],
    out: Folder,
    library: Folder | None = None,
) -> int:
    """Write the raw frame of a scan for other programs, exactly as the sensor gave it.

    Parameters
    ----------
    scan
        Its id, or the beginning or end of it.
    to
        dng for raw converters, tiff (deflated) for ImageJ.
    out
        Folder for the files.
    library
        Which; ~/Retrograph when not given.
    """
    bundle = Library(library or default_library()).find(scan)
    for form in dict.fromkeys(to):
        say(str(export_raw(bundle, form, out)))
    return DONE
