"""`retrosync list`: scans of a library, found by any field, and their labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from device.command_line import Folder, print_json
from host_sync.cli.console import DONE, PARTLY, print_error, print_line, status_spinner
from host_sync.errors import HostError
from host_sync.library.index import Hit, Query, damaged_bundles, search
from host_sync.library.intake import list_set_aside
from host_sync.library.labels import label_scan, read_labels, save_search
from host_sync.library.library import Library, default_library
from host_sync.results.files import RECORD_FILE
from host_sync.text import some_of


def list_command(
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
    set_name: str | None = None,
    add_tag: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    remove_tag: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    set_note: str | None = None,
    like: str | None = None,
    count: Annotated[int, Parameter(name=("--count", "-n"), validator=Number(gte=1))] = 5,
    set_aside: bool = False,
    json: bool = False,
) -> int:
    """List scans of a library, find them by any field, or change their labels; texts may use * and ?.

    Parameters
    ----------
    text
        Words to find in any field of a scan; with an option that changes labels, the scans to change.
    library
        Folder of the library; ~/Retrograph by default.
    job
        Text in the job's name.
    part
        Text in the part's name.
    operator
        Text in the operator's name.
    verdict
        Verdict of the quick look.
    gel
        Identity of the gel.
    device
        Id of the device.
    since
        First day of the scans, by the device's clock.
    until
        Last day of the scans, by the device's clock.
    name
        Name of the label.
    tag
        One of the label's tags.
    note
        Text in the label's note.
    save
        Save these conditions under this name.
    saved
        Use the conditions that were saved under this name, and others given here.
    set_name
        Give one scan a name for lists and the viewer; an empty text removes it.
    add_tag
        Add tags to the scans.
    remove_tag
        Remove tags from the scans.
    set_note
        Give the scans a note; an empty text removes it.
    like
        List instead the scans whose surfaces look most like those of this scan or result folder, shifted or turned too.
    count
        Number of scans that --like lists.
    set_aside
        List instead the bundles that were skipped or moved to set-aside/, with the reason.
    json
        Print one JSON document instead of lines.
    """
    target = Library(library or default_library())
    if set_name is not None or set_note is not None or add_tag or remove_tag:
        return _change_labels(target, text, set_name, add_tag, remove_tag, set_note)
    if like is not None:
        return _list_alike(target, like, count, json=json)
    if set_aside:
        return _list_set_aside(target, json=json)
    if since is not None and until is not None and since > until:
        raise HostError(f"--since {since} is later than --until {until}: swap them")
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
    if not hits:
        print_error(f"{target.root}: no scan matches", DONE)
    for reason in damaged:
        print_error(reason, PARTLY)
    return PARTLY if damaged else DONE


def _change_labels(
    library: Library,
    scans: Sequence[str],
    name: str | None,
    tags: Sequence[str],
    removed: Sequence[str],
    note: str | None,
) -> int:
    """Change the labels of scans that are named exactly, and print them; scans themselves stay as they are."""
    if not scans:
        raise HostError("name the scans to label: retrosync list SCAN --add-tag worn")
    found = [library.named(one).scan_id for one in scans]
    if name and len(found) > 1:
        raise HostError("a name is for one scan: give several a tag")
    for scan_id in found:
        label = label_scan(library, scan_id, name=name, tag=tags, untag=removed, note=note)
        print_line("  ".join((scan_id, label.name or "-", ",".join(label.tags) or "-", label.note or "-")))
    return DONE


def _list_alike(library: Library, scan: str, count: int, *, json: bool) -> int:
    """List the surfaces that look most like one, and what could not be compared."""
    library.require()
    folder = Path(scan)
    if not (folder / RECORD_FILE).is_file():
        folder = library.newest_result(library.named(scan))
    with status_spinner() as report_progress:
        from host_sync.likeness.search import alike

        answer = alike(folder, library.root, count, report_progress)
    failed = [f"not compared: {name}: {reason}" for name, reason in answer.unreadable]
    if answer.without_results:
        names = some_of(answer.without_results)
        failed.append(f"not compared, without results: {names}: run retrosync reconstruct --library {library.root}")
    for words in failed:
        print_error(words, PARTLY)
    if json:
        print_json(answer)
        return PARTLY if failed else DONE
    for one in answer.found:
        print_line(f"{one.distance:7.2f}  {one.scan}  {one.folder}")
    print_line(f"{answer.compared} surfaces compared; the less the number in front, the more alike")
    for name, reason in answer.left_out:
        print_line(f"not compared: {name}: {reason}")
    return PARTLY if failed else DONE


def _list_set_aside(library: Library, *, json: bool) -> int:
    """List what was refused or replaced, with the reason."""
    library.require()
    if json:
        print_json({"library": library.root, "set_aside": list_set_aside(library.root)})
        return DONE
    for entry in list_set_aside(library.root):
        print_line(f"{entry.why.kind}/{entry.why.name}  {entry.why.time:%Y-%m-%d %H:%M} UTC: {entry.why.reason}")
        if entry.folder is not None:
            print_line(f"  kept in {entry.folder}")
    return DONE


COLUMNS = ("SCAN", "TAKEN", "VERDICT", "JOB", "PART", "GEL", "OPERATOR", "NAME", "TAGS", "NOTE")
WIDEST = 40


def _aligned(hits: Sequence[Hit]) -> list[str]:
    """Return a header and a line per scan, in columns; nothing without scans."""
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
    """Return a query with the conditions of a saved search that it does not state itself."""
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
