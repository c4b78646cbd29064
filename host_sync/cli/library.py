"""`retrosync search`, `list`, `verify`, `repair`, `mirror`, `forget`, `reprocess`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import fields
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from device.command_line import Folder, print_json
from device.errors import DeviceError
from host_sync.cli.console import BAD_INPUT, DONE, PARTLY, print_error, print_line, status_spinner
from host_sync.cli.devices import known_devices
from host_sync.errors import HostError
from host_sync.library.index import Hit, Query, damaged_bundles, search
from host_sync.library.labels import Label, label_scan, read_labels, save_search
from host_sync.library.library import Library, default_library
from host_sync.library.set_aside import list_set_aside
from host_sync.library.verification import adopt as add_to_record
from host_sync.library.verification import verify_library
from host_sync.offload.resolve import open_source


def search_command(
    *text: str,
    library: Folder | None = None,
    job: str | None = None,
    part: str | None = None,
    operator: str | None = None,
    verdict: Literal["good", "doubtful", "retake"] | None = None,
    gel: str | None = None,
    device: str | None = None,
    since: date | None = None,
    until: date | None = None,
    name: str | None = None,
    tag: str | None = None,
    note: str | None = None,
    save: str | None = None,
    saved: str | None = None,
    json: bool = False,
) -> int:
    """List scans of a library; texts may use * and ?.

    Parameters
    ----------
    text
        Words that stand anywhere in what is known of a scan.
    library
        Folder of the library; ~/Retrograph by default.
    job
        Text in the annotation.
    part
        Text in the annotation.
    operator
        Text in the annotation.
    verdict
        Verdict of the quick look.
    gel
        Identity of the gel.
    device
        Id of the device.
    since
        First day, by the device's clock.
    until
        Last day, by the device's clock.
    name
        Name that `retrosync label` gave.
    tag
        One of its tags.
    note
        Its note.
    save
        Keep these conditions under a name.
    saved
        Use the conditions that were saved under this name; others are added.
    json
        Print one JSON document instead of lines.
    """
    if since is not None and until is not None and since > until:
        raise HostError(f"--since {since} is later than --until {until}: swap them")
    target = Library(library or default_library())
    query = Query(job, part, operator, verdict, gel, device, since, until, name, tag, note, " ".join(text) or None)
    target.require()
    if saved is not None:
        query = _with_saved(query, target, saved)
    if save is not None:
        given = {one.name: str(value) for one in fields(query) if (value := getattr(query, one.name)) is not None}
        save_search(target, save, given)
    hits, damaged = search(target, query), damaged_bundles(target)
    if json:
        print_json({"library": target.root, "scans": hits, "damaged": damaged})
        return PARTLY if damaged else DONE
    for line in _aligned(hits):
        print_line(line)
    for reason in damaged:
        print_error(reason, PARTLY)
    return PARTLY if damaged else DONE


COLUMNS = ("SCAN", "TAKEN", "VERDICT", "JOB", "PART", "GEL", "OPERATOR", "NAME", "TAGS", "NOTE")
WIDEST = 40


def _aligned(hits: Sequence[Hit]) -> list[str]:
    """A header and a line per scan, in columns; nothing without scans."""
    rows = [
        (
            hit.scan_id, hit.taken[:16], _verdict(hit), hit.job or "-", hit.part or "-", hit.gel, hit.operator or "-",
            hit.name or "-", ",".join(hit.tags) or "-", " ".join(hit.note.split()) or "-",
        )
        for hit in hits
    ]  # fmt: skip
    every = [COLUMNS, *rows] if rows else []
    widths = [min(WIDEST, max(len(row[at]) for row in every)) for at in range(len(COLUMNS))] if rows else []
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in every]


def _verdict(hit: Hit) -> str:
    return f"{hit.verdict} (replaced)" if hit.replaced_by else hit.verdict


def _with_saved(query: Query, library: Library, name: str) -> Query:
    """A query with the conditions of a saved search that it does not state itself."""
    searches = read_labels(library.root).searches
    if name not in searches:
        known = ", ".join(searches) or "none is saved"
        raise HostError(f"no search is saved as {name!r} ({known}): save one with --save")
    own = {one.name: value for one in fields(query) if (value := getattr(query, one.name)) is not None}
    kept: dict[str, Any] = {**searches[name], **own}
    for day in ("since", "until"):
        if isinstance(kept.get(day), str):
            try:
                kept[day] = date.fromisoformat(kept[day])
            except ValueError as error:
                raise HostError(f"saved search {name!r}: {day} is {kept[day]!r}, not a date as 2026-01-31") from error
    return Query(**{one.name: kept[one.name] for one in fields(Query) if one.name in kept})


def label_command(
    *scans: str,
    library: Folder | None = None,
    name: str | None = None,
    tag: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    untag: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    note: str | None = None,
) -> int:
    """Give scans a name, tags or a note; without any, print what they have.

    Scans themselves stay as they are.

    Parameters
    ----------
    scans
        Scans by id, its beginning or end, by their name, or by the name of the part.
    library
        Folder of the library; ~/Retrograph by default.
    name
        Name of the scan in lists and in the viewer; an empty text removes it.
    tag
        Tags to add.
    untag
        Tags to remove.
    note
        Note; an empty text removes it.
    """
    target = Library(library or default_library())
    if not scans:
        raise HostError("name the scans to label: retrosync label SCAN --tag worn")
    found = [target.named(one).scan_id for one in scans]
    if name and len(found) > 1:
        raise HostError("a name is for one scan: give several a tag")
    changes = name is not None or note is not None or tag or untag
    for scan_id in found:
        if changes:
            label = label_scan(target, scan_id, name=name, tag=tag, untag=untag, note=note)
        else:
            label = read_labels(target.root).scans.get(scan_id, Label())
        print_line("  ".join((scan_id, label.name or "-", ",".join(label.tags) or "-", label.note or "-")))
    return DONE


def list_command(*, library: Folder | None = None, set_aside: bool = False, json: bool = False) -> int:
    """List the scans of a library, or what was refused and set aside.

    Parameters
    ----------
    library
        Folder of the library; ~/Retrograph by default.
    set_aside
        List instead what was passed over or moved to set-aside/, with the reason.
    json
        Print one JSON document instead of lines.
    """
    target = Library(library or default_library())
    if not set_aside:
        return search_command(library=target.root, json=json)
    target.require()
    if json:
        print_json({"library": target.root, "set_aside": list_set_aside(target.root)})
        return DONE
    for entry in list_set_aside(target.root):
        print_line(f"{entry.why.kind}/{entry.why.name}  {entry.why.time:%Y-%m-%d %H:%M} UTC: {entry.why.reason}")
        if entry.folder is not None:
            print_line(f"  kept in {entry.folder}")
    return DONE


def verify_command(
    *, library: Folder | None = None, partial: str | None = None, adopt: bool = False, json: bool = False
) -> int:
    """Compare a library with its intake record and hash its files: names what is lost, changed or unknown.

    Parameters
    ----------
    library
        Folder of the library; ~/Retrograph by default.
    partial
        Hash only this fraction, such as 5%; the next partial run continues after it. Missing files are found in any
        case.
    adopt
        Record whole bundles that the intake record lacks, such as an older release's; replaces a damaged record.
    json
        Print one JSON document instead of lines.
    """
    target = Library(library or default_library())
    with status_spinner() as tell:
        found = verify_library(target, tell, fraction=1.0 if partial is None else _fraction(partial))
    if json:
        added = {"added_to_record": add_to_record(target, found)} if adopt else {}
        print_json({"library": target.root, **{name: getattr(found, name) for name in found.__slots__}, **added})
        return DONE if found.complete else PARTLY
    skipped = f", {found.skipped} not hashed this time" if found.skipped else ""
    print_line(f"{found.sound} of {found.total} verified{skipped}")
    for path in found.unlisted_files:
        print_line(f"Note: {path} is in no manifest.")
    for path in found.unfinished:
        print_line(f"Note: {path} waits for its transfer to continue.")
    if adopt:
        print_line(f"{add_to_record(target, found)} added to the intake record.")
    else:
        for path in found.unrecorded:
            print_line(f"Note: {path} is not in the intake record: `retrosync verify --adopt` adds it.")
    if found.record_fault is not None:
        print_error(found.record_fault, PARTLY)
    for bundle in (*found.lost, *found.damaged):
        print_error(f"{bundle.directory.name}: {bundle.reason}", PARTLY)
    if found.lost or found.damaged:
        print_line("`retrosync repair SOURCE` fetches these again from a card, a device or a mirror.")
        print_line("`retrosync forget SCAN` takes one that you removed yourself out of the record.")
    return DONE if found.complete else PARTLY


def _fraction(text: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d+)?) ?%?", text.strip())
    if found is None or not 0.0 < float(found[1]) <= 100.0:
        raise HostError(f"--partial {text!r}: give a fraction of the library, such as 5%")
    return float(found[1]) / 100.0


def forget_command(*names: str, library: Folder | None = None) -> int:
    """Take bundles that you removed yourself out of the intake record, so that `verify` no longer misses them.

    Parameters
    ----------
    names
        Complete ids of the bundles.
    library
        Folder of the library; ~/Retrograph by default.
    """
    target = Library(library or default_library())
    target.require()
    with target.writing():
        for name in names:
            target.forget(name)
            print_line(f"{name} is no longer expected.")
    return DONE


def repair_command(*sources: str, library: Folder | None = None) -> int:
    """Fetch lost and damaged bundles again; damaged copies move to set-aside/.

    Parameters
    ----------
    sources
        Cards, folders, mirrors or paired devices, tried in this order.
    library
        Folder of the library; ~/Retrograph by default.
    """
    from host_sync.offload.repair import repair

    target = Library(library or default_library())
    target.require()
    if not sources:
        raise HostError("name a card, folder, mirror or paired device to fetch from")
    with ExitStack() as stack, status_spinner() as tell:
        opened = [stack.enter_context(open_source(source, known_devices())) for source in sources]
        report = repair(target, opened, tell)
    print_line(f"{len(report.repaired)} repaired, {len(report.failed)} not: {target.root}")
    for failure in report.failed:
        print_error(f"{failure.bundle_id}: {failure.reason}", PARTLY)
    if report.before.record_fault is not None:
        print_error(report.before.record_fault, PARTLY)
    return PARTLY if report.failed or report.before.record_fault else DONE


def mirror_command(library: Folder, destination: str, *, verify: bool = False) -> int:
    """Copy what another disk or an SFTP server lacks, and read back every file there.

    Parameters
    ----------
    library
        The library to copy.
    destination
        A folder, or sftp://USER@HOST:PORT/FOLDER.
    verify
        Hash again what is there already.
    """
    from host_sync.offload.mirror import SftpPlace, mirror_to_folder, mirror_to_sftp

    target, place = Library(library), SftpPlace.parse(destination)
    with status_spinner() as tell:
        if place is None:
            report = mirror_to_folder(target, Path(destination), tell, verify=verify)
        else:
            report = mirror_to_sftp(target, place, tell, verify=verify)
    print_line(f"{len(report.copied)} copied and verified, {len(report.already_there)} already there: {destination}")
    for failure in report.failed:
        print_error(f"{failure.bundle_id}: {failure.reason}", PARTLY)
    return PARTLY if report.failed else DONE


def reprocess_command(
    *names: str,
    library: Folder | None = None,
    job: Annotated[Any, Parameter(parse=False)] = None,
) -> int:
    """Reconstruct scans with results again: the same version must give the same bits; others list changes.

    Parameters
    ----------
    names
        Scans of the library; all that have results when none is named.
    library
        Folder of the library; ~/Retrograph by default.
    """
    from host_sync.evaluation.reprocess import reprocess
    from host_sync.reconstruction.from_library import LibraryReconstructor

    target = Library(library or default_library())
    scans = [target.find(name) for name in names] or list(target.scans().bundles)
    job = job or LibraryReconstructor(target)
    identical, broken = 0, 0
    for scan in scans:
        try:
            comparisons = reprocess(target, job, scan)
        except (DeviceError, HostError) as error:
            print_error(error, PARTLY)
            broken += 1
            continue
        for comparison in comparisons:
            identical += not comparison.differences
            broken += not comparison.as_promised
            verdict = "identical" if not comparison.differences else "differs"
            print_line(f"{comparison.results}: {verdict}")
            for difference in comparison.differences:
                print_line(f"  {difference}")
    print_line(f"{identical} identical, {broken} not as expected")
    if broken:
        return PARTLY if identical else BAD_INPUT
    return DONE
