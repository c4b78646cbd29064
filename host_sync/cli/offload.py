"""`retrosync pull` and `push-calibration`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter
from cyclopts.validators import Number

from device.command_line import Folder
from host_sync.cli.console import BAD_INPUT, CONNECTION, DONE, PARTLY, print_error, print_line, progress
from host_sync.cli.devices import known_devices
from host_sync.errors import PairingError, SourceError
from host_sync.library.library import Library, default_library
from host_sync.offload.directory import DirectorySource
from host_sync.offload.ingest import ReceiptWriter
from host_sync.offload.paired_devices import this_host
from host_sync.offload.pull import PullProgress, pull, sync, utc_now
from host_sync.offload.pull_log import PullReport
from host_sync.offload.resolve import Address, is_folder, open_device, open_source
from host_sync.offload.source import PATIENCE_S

ShowPull = Callable[[str, PullProgress], None]

MAX_PATIENCE_S: Final = 3600.0


def pull_command(
    *sources: str,
    library: Folder | None = None,
    at: str | None = None,
    rehash: bool = False,
    patience_s: Annotated[float, Parameter(validator=Number(gt=0, lte=MAX_PATIENCE_S))] = PATIENCE_S,
) -> int:
    """Copy what the library lacks from every paired device, or from those, cards and folders named.

    Each copy is read back, and a receipt is left. Devices are pulled from side by side.

    Parameters
    ----------
    sources
        Paired devices, and cards, mounts or folders that hold a device's store; all paired devices when none is named.
    library
        Folder of the library to copy to; ~/Retrograph by default.
    at
        The present address of the one device named, HOST or HOST:PORT, if it has changed since pairing.
    rehash
        Hash again what an earlier pull has verified; a damaged copy is named and its receipt withdrawn.
    patience_s
        Seconds without any data after which a device is given up; more for a slow or busy device.
    """
    target, devices = Library(library or default_library()), known_devices()
    folders = [source for source in sources if is_folder(source)]
    wanted = [devices.find(source) for source in sources if source not in folders] if sources else devices.all()
    if not sources and not wanted:
        raise PairingError("no device is paired: `retrosync pair HOST` first, or name a card or folder")
    if at is not None and (folders or len(wanted) != 1):
        raise PairingError("--at is the address of one device: name that device alone")
    address = Address.parse(at) if at else None
    codes = []
    with progress("bytes") as show_bytes:

        def show(source: str, state: PullProgress) -> None:
            show_bytes(f"{source}: {state.bundle_id}", state.done_bytes, state.total_bytes, source)

        reports = [(folder, _pull_folder(folder, target, show, rehash=rehash)) for folder in folders]
        outcomes = []
        if wanted:
            outcomes = sync(
                wanted,
                target,
                devices,
                lambda device: open_device(device, devices, address, patience_s),
                lambda device, state: show(device.device_id, state),
                verify=rehash,
            )
    alone = len(folders) + len(wanted) == 1
    for folder, report in reports:
        codes.append(_print_report(report, str(target.root) if alone else f"{folder}, {target.root}"))
    for device, outcome in zip(wanted, outcomes, strict=True):
        if isinstance(outcome, PullReport):
            codes.append(_print_report(outcome, str(target.root) if alone else f"{device.device_id}, {target.root}"))
        else:
            codes.append(print_error(outcome, CONNECTION if isinstance(outcome, SourceError) else BAD_INPUT))
    return PARTLY if DONE in codes and max(codes) > DONE else max(codes)


def _pull_folder(folder: str, target: Library, show: ShowPull, *, rehash: bool) -> PullReport:
    """Copy what the library lacks from a card, mount or folder."""
    opened = DirectorySource(Path(folder))
    writer = ReceiptWriter(this_host(), utc_now)
    return pull(opened, target, lambda state: show(opened.name, state), writer, verify=rehash)


def push_command(source: str, calibration: str, /, *, library: Folder | None = None, at: str | None = None) -> int:
    """Put a calibration of the library into a device's inbox; the device verifies it on import.

    Parameters
    ----------
    source
        A paired device, or the folder of a store.
    calibration
        Its id, or the beginning or end of it.
    library
        Folder of the library to copy from; ~/Retrograph by default.
    at
        The device's present address, HOST or HOST:PORT, if it has changed since pairing.
    """
    from host_sync.offload.push import push_calibration

    bundle = Library(library or default_library()).find_calibration(calibration)
    with open_source(source, known_devices(), Address.parse(at) if at else None) as opened:
        push_calibration(opened, bundle)
    print_line(
        f"{bundle.calibration_id} is in the inbox of {source}: "
        "`retroscan calibrations import-inbox --activate` imports it."
    )
    return DONE


def _print_report(report: PullReport, where: str) -> int:
    """Print what a pull did; returns the exit code."""
    total = report.here + len(report.failed)
    print_line(f"{len(report.copied)} copied and verified, {len(report.already_there)} already there: {where}")
    earlier = f", {len(report.unread)} by an earlier pull (--rehash hashes them again)" if report.unread else ""
    print_line(f"{report.here - len(report.unread)} of {total} verified{earlier}")
    for scan in report.without_calibration:
        print_line(f"Note: scan {scan} has no calibration here.")
    if report.unreceipted is not None:
        print_line(f"Note: no receipts were left, so the device keeps its scans: {report.unreceipted}")
    for failure in (*report.failed, *report.refused_receipts):
        print_error(f"{failure.bundle_id}: {failure.reason}", PARTLY)
    if report.lost is not None:
        return print_error(report.lost, CONNECTION)
    return DONE if report.complete else PARTLY
