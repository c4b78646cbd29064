"""`retrosync search`, `verify`, `reprocess`."""

from __future__ import annotations

from datetime import date
from typing import Literal

from cyclopts import App

from device.errors import DeviceError
from host_sync.commands.console import BAD_INPUT, DONE, PARTLY, Folder, complain, say, telling
from host_sync.errors import HostError
from host_sync.library import Library, default_library
from host_sync.library_index import Query, search
from host_sync.verification import verify_library


def register(app: App) -> None:
    """Add the commands of this theme."""
    app.command(search_command, name="search")
    app.command(verify_command, name="verify")
    app.command(reprocess_command, name="reprocess")


def search_command(
    *,
    library: Folder | None = None,
    job: str | None = None,
    part: str | None = None,
    operator: str | None = None,
    verdict: Literal["good", "doubtful", "retake"] | None = None,
    gel: str | None = None,
    device: str | None = None,
    since: date | None = None,
    until: date | None = None,
) -> int:
    """List scans of a library; texts know * and ?.

    Parameters
    ----------
    library
        Where; ~/Retrograph when not given.
    job
        As it was annotated.
    part
        As it was annotated.
    operator
        As it was annotated.
    verdict
        Of the quick look.
    gel
        Identity of the gel.
    device
        Id of the device.
    since
        First day, by the device's clock.
    until
        Last day, by the device's clock.
    """
    if since is not None and until is not None and since > until:
        raise HostError(f"--since {since} is later than --until {until}: no day lies between them, swap them")
    query = Query(job, part, operator, verdict, gel, device, since, until)
    for hit in search(Library(library or default_library()), query):
        say("  ".join((hit.scan_id, hit.taken[:16], hit.verdict, hit.job or "-", hit.part or "-", hit.gel)))
    return DONE


def verify_command(*, library: Folder | None = None) -> int:
    """Hash every file of a library again and name what is not as it was published.

    Parameters
    ----------
    library
        Which; ~/Retrograph when not given.
    """
    with telling() as tell:
        found = verify_library(Library(library or default_library()), tell)
    say(f"{found.sound} of {found.sound + len(found.damaged)} verified")
    for path in found.strangers:
        say(f"Note: {path} is in no manifest.")
    for path in found.unfinished:
        say(f"Note: {path} waits for its transfer to go on.")
    for bundle in found.damaged:
        complain(f"{bundle.directory.name}: {bundle.reason}", PARTLY)
    if found.damaged:
        say("Move what is damaged away and sync again: it is fetched anew while its device or card still has it.")
    return PARTLY if found.damaged else DONE


def reprocess_command(*names: str, library: Folder | None = None) -> int:
    """Reconstruct again what has results: the same version must give the same bits; across versions, say what changed.

    Parameters
    ----------
    names
        Scans of the library; all that have results when none is named.
    library
        Which; ~/Retrograph when not given.
    """
    from host_sync.reconstruction.library_job import LibraryJob
    from host_sync.reconstruction.reprocess import reprocess

    target = Library(library or default_library())
    scans = [target.find(name) for name in names] or list(target.scans().bundles)
    job = LibraryJob(target)
    identical, broken = 0, 0
    for scan in scans:
        try:
            comparisons = reprocess(target, job, scan)
        except (DeviceError, HostError) as error:
            complain(error, PARTLY)
            broken += 1
            continue
        for comparison in comparisons:
            identical += not comparison.differences
            broken += not comparison.as_promised
            verdict = "identical" if not comparison.differences else "differs"
            say(f"{comparison.results}: {verdict}")
            for difference in comparison.differences:
                say(f"  {difference}")
    say(f"{identical} identical, {broken} not as promised")
    if broken:
        return PARTLY if identical else BAD_INPUT
    return DONE
