"""`retrosync verify`: compares a library with its record; repairs, mirrors, forgets or reproduces on request."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter

from device.command_line import Folder, print_json
from device.errors import DeviceError
from host_sync.cli.console import BAD_INPUT, DONE, PARTLY, print_error, print_line, status_spinner
from host_sync.cli.devices import known_devices
from host_sync.errors import HostError
from host_sync.library.library import Library, default_library
from host_sync.library.verification import adopt as add_to_record
from host_sync.library.verification import verify_library
from host_sync.offload.source import open_source

ACTIONS: Final = ("--repair", "--mirror", "--forget", "--reproduce")


def verify_command(
    *names: str,
    library: Folder | None = None,
    partial: str | None = None,
    adopt: bool = False,
    repair: Annotated[tuple[str, ...] | None, Parameter(consume_multiple=True)] = None,
    mirror: str | None = None,
    rehash: bool = False,
    forget: bool = False,
    reproduce: bool = False,
    json: bool = False,
) -> int:
    """Compare a library with its intake record and hash its files; repair, mirror, forget or reproduce on request.

    Without --repair, --mirror, --forget and --reproduce it names what is lost, changed or unknown.

    Parameters
    ----------
    names
        Bundles to forget, by their complete ids, or scans to reproduce.
    library
        Folder of the library; ~/Retrograph by default.
    partial
        Hash only this fraction, such as 5%; the next partial run continues after it. Missing files are found in any
        case.
    adopt
        Record whole bundles that the intake record lacks, such as an older release's; replaces a damaged record.
    repair
        Fetch lost and damaged bundles again from these cards, folders, mirrors or paired devices, in this order;
        damaged copies move to set-aside/.
    mirror
        Copy to this folder or sftp://USER@HOST:PORT/FOLDER all that it lacks, and read back every file there.
    rehash
        With --mirror, hash again what is there already.
    forget
        Take the named bundles, which you removed yourself, out of the intake record.
    reproduce
        Reconstruct scans with results again: the same version must give the same bits; for others, list changes.
    json
        Print one JSON document instead of lines.
    """
    target = Library(library or default_library())
    given = (repair is not None, mirror is not None, forget, reproduce)
    chosen = [name for name, is_given in zip(ACTIONS, given, strict=True) if is_given]
    if len(chosen) > 1:
        raise HostError(f"{' and '.join(chosen)} are different work: give one at a time")
    if names and not (forget or reproduce):
        raise HostError(f"{names[0]}: verify takes no names; --forget and --reproduce do")
    if repair is not None:
        return _repair(target, repair)
    if mirror is not None:
        return _mirror(target, mirror, rehash=rehash)
    if forget:
        return _forget(target, names)
    if reproduce:
        return reproduce_results(target, names)
    return _verify(target, partial, adopt=adopt, json=json)


def _verify(target: Library, partial: str | None, *, adopt: bool, json: bool) -> int:
    """Name what is lost, changed or unknown."""
    with status_spinner() as report_progress:
        found = verify_library(target, report_progress, fraction=1.0 if partial is None else _fraction(partial))
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
        print_line("`retrosync verify --repair SOURCE` fetches these again from a card, a device or a mirror.")
        print_line("`retrosync verify SCAN --forget` takes one that you removed yourself out of the record.")
    return DONE if found.complete else PARTLY


def _fraction(text: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d+)?) ?%?", text.strip())
    if found is None or not 0.0 < float(found[1]) <= 100.0:
        raise HostError(f"--partial {text!r}: give a fraction of the library, such as 5%")
    return float(found[1]) / 100.0


def _forget(target: Library, names: Sequence[str]) -> int:
    """Take bundles out of the intake record."""
    if not names:
        raise HostError("name the bundles that you removed: retrosync verify ID --forget")
    target.require()
    with target.writing():
        for name in names:
            target.forget(name)
            print_line(f"{name} is no longer expected.")
    return DONE


def _repair(target: Library, sources: Sequence[str]) -> int:
    """Fetch lost and damaged bundles again."""
    from host_sync.offload.mirror import repair

    if not sources:
        raise HostError("name a card, folder, mirror or paired device to fetch from: retrosync verify --repair SOURCE")
    target.require()
    with ExitStack() as stack, status_spinner() as report_progress:
        opened = [stack.enter_context(open_source(source, known_devices())) for source in sources]
        report = repair(target, opened, report_progress)
    print_line(f"{len(report.repaired)} repaired, {len(report.failed)} not: {target.root}")
    for failure in report.failed:
        print_error(f"{failure.bundle_id}: {failure.reason}", PARTLY)
    if report.before.record_fault is not None:
        print_error(report.before.record_fault, PARTLY)
    return PARTLY if report.failed or report.before.record_fault else DONE


def _mirror(target: Library, destination: str, *, rehash: bool) -> int:
    """Copy what another disk or an SFTP server lacks."""
    from host_sync.offload.mirror import SftpPlace, mirror_to_folder, mirror_to_sftp

    place = SftpPlace.parse(destination)
    with status_spinner() as report_progress:
        if place is None:
            report = mirror_to_folder(target, Path(destination), report_progress, verify=rehash)
        else:
            report = mirror_to_sftp(target, place, report_progress, verify=rehash)
    print_line(f"{len(report.copied)} copied and verified, {len(report.already_there)} already there: {destination}")
    for failure in report.failed:
        print_error(f"{failure.bundle_id}: {failure.reason}", PARTLY)
    return PARTLY if report.failed else DONE


def reproduce_results(target: Library, names: Sequence[str] = (), job: Any = None) -> int:
    """Reconstruct scans with results again; all that have some when none is named.

    job : reconstructs; the library's own by default
    """
    from host_sync.reconstruction.reprocess import reprocess
    from host_sync.reconstruction.scans import LibraryReconstructor

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
