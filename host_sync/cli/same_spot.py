"""`retrosync same-spot`: what changed on an object between two presses."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from device.command_line import Folder, print_json
from device.io.atomic import check_replaceable
from host_sync.cli.console import DONE, print_line, status_spinner, tell_of_compiling
from host_sync.errors import ViewError
from host_sync.library.library import Library, default_library
from host_sync.results.files import RECORD_FILE

if TYPE_CHECKING:
    from host_sync.same_spot.comparing import SameSpotRecord

LISTED: Final = 10
COVERAGE: Final = 2.0
"""± in the summary is so many standard uncertainties."""


def same_spot_command(
    first: str,
    second: str,
    /,
    *,
    out: Folder | None = None,
    library: Folder | None = None,
    near: tuple[float, float, float] | None = None,
    json: bool = False,
) -> int:
    """Compare two presses of one spot: the second minus the first, significant changes, what is too small to see.

    Parameters
    ----------
    first
        The earlier result: a folder that reconstruct wrote, or a scan of the library by id, label's name or part.
    second
        The later one.
    out
        Folder for the difference, its σ, a picture and same_spot.json; without it the summary is printed only.
    library
        Folder of the library; ~/Retrograph by default.
    near
        Where the object lies in the second press: mm down, mm right, degrees clockwise; for when it is not found.
    json
        Print same_spot.json instead of the summary.
    """
    folders = [_result(name, library) for name in (first, second)]
    if folders[0].resolve() == folders[1].resolve():
        raise ViewError(f"{first} and {second} are one result: name an earlier and a later press")
    if out is not None:
        check_replaceable(out, "same_spot.json")  # before the work
    with status_spinner() as tell:
        tell_of_compiling()
        tell("loading compiled code")
        from host_sync.results.reader import read_result
        from host_sync.same_spot.comparing import compared, write_comparison

        tell("reading both results")
        surfaces = [read_result(folder, samples=False) for folder in folders]
        tell("looking for the spot")
        comparison = compared(surfaces[0], surfaces[1], near)
        if out is not None:
            write_comparison(comparison, out)
    if json:
        print_json(comparison.record)
        return DONE
    for line in _summary(comparison.record):
        print_line(line)
    return DONE


def _result(name: str, library: Path | None) -> Path:
    folder = Path(name)
    if (folder / RECORD_FILE).is_file():
        return folder
    held = Library(library or default_library())
    held.require()
    return held.newest_result(held.named(name))


def _summary(record: SameSpotRecord) -> Iterator[str]:
    down, right = (1e-3 * part for part in record.shift_um)
    sigma = record.shift_sigma_um
    about = "" if sigma is None else f" ± {COVERAGE * sigma:.2g} µm"
    yield (
        f"{record.second}: the object lies {right:+.3f} mm right and {down:+.3f} mm down of where it lay in "
        f"{record.first}{about}, turned by {record.turn_deg:+.2f}°; {record.overlap_share:.0%} in common"
    )
    stated = record.height_sigma_median_um
    of_sigma = "" if stated is None else f"; its standard uncertainty {stated:.3g} µm in the median"
    yield f"difference: rms {record.residual_um:.3g} µm{of_sigma}"
    for one in record.changes[:LISTED]:
        yield (
            f"changed: {one.height_um:+.2f} µm ± {COVERAGE * one.sigma_um:.2f} µm "
            f"at {1e-3 * one.column_um:.2f} mm right, {1e-3 * one.row_um:.2f} mm down, "
            f"{1e-3 * one.diameter_um:.2g} mm across"
        )
    if len(record.changes) > LISTED:
        yield f"and {len(record.changes) - LISTED} changes more: --json lists them"
    if not record.limits:
        yield "nothing can be judged: the common field is too small or has too many holes"
    else:
        limits = ", ".join(f"{one.height_um:.2g} µm if {1e-3 * one.diameter_um:.2g} mm across" for one in record.limits)
        more = "no other change" if record.changes else "no change"
        yield f"{more} at this spot beyond {limits}; {record.judged_share:.0%} of the field judged"
    for warning in record.warnings:
        yield f"DOUBTFUL: {warning}"
