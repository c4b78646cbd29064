"""`retrosync pair`, `status`, `pull` and `push-calibration`: the devices of this workstation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter
from cyclopts.validators import Number

from device.command_line import Folder, print_json
from device.pairing import PAIRING_PORT
from host_sync.cli.console import BAD_INPUT, CONNECTION, DONE, PARTLY, print_error, print_line, progress
from host_sync.errors import PairingError, SourceError
from host_sync.library.library import Library, default_library
from host_sync.offload.ingest import PullReport, ReceiptWriter
from host_sync.offload.paired_devices import PairedDevices, default_devices_folder, this_host
from host_sync.offload.pull import PullProgress, pull, sync, utc_now
from host_sync.offload.source import MAX_PORT, PATIENCE_S, Address, DirectorySource, is_folder, open_device, open_source

CLOCK_SEEN_S: Final = 2.0
LISTEN_S: Final = 3.0
UNITS_S: Final = (("years", 31_557_600.0), ("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0), ("s", 1.0))


def known_devices() -> PairedDevices:
    """Return the devices in this user's settings."""
    return PairedDevices(default_devices_folder())


def pair_command(
    host: str | None = None,
    /,
    *,
    card: Folder | None = None,
    port: int = PAIRING_PORT,
    replace: bool = False,
) -> int:
    """Pair with a device whose pairing window is open: compare two codes; or by files on its memory card.

    Parameters
    ----------
    host
        The device's address; by default that of the one device that announces itself on the local network.
    card
        Its mounted memory card, when it has no screen: run this, start the device with it, run this again.
    port
        Port of its pairing window.
    replace
        Accept a new key of a known device, because you set it up again.
    """
    from host_sync.offload import paired_devices

    devices = known_devices()
    own = paired_devices.own_card(devices, this_host())
    if card is not None:
        device = paired_devices.pair_by_card(card, own, host)
        if device is None:
            print_line(f"This workstation's key is on {card} now: start the device with it, then run this again.")
            return DONE
    else:
        device = paired_devices.pair_over_network(host or _only_announced(), _checked_port(port), own, _same_code)
    paired_devices.keep(devices, device, replace=replace)
    print_line(f"Paired with {device.device_id} at {device.host}:{device.port}.")
    return DONE


def _only_announced() -> str:
    """Return the address of the one device that announces itself on the local network."""
    from host_sync.offload.paired_devices import discover

    print_line("Looking for the device on this network ...")
    found = discover(LISTEN_S)
    if not found:
        raise SourceError("no device announces itself on this network: name its address, or --card and its memory card")
    if len(found) > 1:
        raise PairingError(f"several devices announce themselves: name one of {', '.join(one.host for one in found)}")
    print_line(f"Found {found[0].name} at {found[0].host}.")
    return found[0].host


def _same_code(code: str) -> bool:
    """Show our code and ask whether the device shows it, too."""
    print_line(f"Code {code}. If the device shows the same code, confirm it there, then type yes here.")
    try:
        return input("Same code? [yes/no] ").strip().lower() in {"y", "yes"}
    except EOFError as error:
        raise PairingError("nobody compared the codes: repeat in a terminal") from error


def _checked_port(port: int) -> int:
    if not 1 <= port <= MAX_PORT:
        raise PairingError(f"--port {port}: is no port: give 1 to {MAX_PORT}")
    return port


def status_command(*, network: bool = False, seconds: float = LISTEN_S, json: bool = False) -> int:
    """List the paired devices and how the last pull from each went; with --network, the devices in reach.

    Parameters
    ----------
    network
        List instead the devices that announce themselves on the local network.
    seconds
        How long to listen for announcements.
    json
        Print one JSON document instead of lines.
    """
    if network:
        return _list_announced(seconds, json=json)
    devices = known_devices()
    known = devices.all()
    if json:
        facts = [{"device": one, "last_sync": devices.sync_state(one.device_id)} for one in known]
        print_json({"devices": facts})
        return DONE
    for device in known:
        state = devices.sync_state(device.device_id)
        print_line(f"{device.device_id}  {device.host}:{device.port}")
        if state is None:
            print_line("  never synced")
            continue
        clock = _describe_clock(state.clock_offset_s)
        counted = f"{state.verified} in the library, {state.failed} failed"
        print_line(f"  synced {state.synced:%Y-%m-%d %H:%M} UTC: {counted}; {clock}")
    if not known:
        print_line("No device is paired: `retrosync pair HOST` makes one known.")
    return DONE


def _list_announced(seconds: float, *, json: bool) -> int:
    """List the devices that announce themselves on the local network."""
    from host_sync.offload.paired_devices import discover

    found = discover(seconds)
    if json:
        print_json({"announced": found})
    for one in () if json else found:
        print_line(f"{one.name}  {one.host}:{one.port}  {' '.join(one.addresses)}")
    if not found:
        return print_error("no device was found: check cable or network, or give its address to `pair`", CONNECTION)
    return DONE


def _describe_clock(offset_s: float | None) -> str:
    """Return how far a device's clock was off; measured to about a second."""
    if offset_s is None:
        return "its clock was not measured"
    if abs(offset_s) < CLOCK_SEEN_S:
        return "its clock was right"
    unit, length_s = next((name, size_s) for name, size_s in UNITS_S if abs(offset_s) >= 2 * size_s)
    return f"its clock was {abs(offset_s) / length_s:.0f} {unit} {'ahead' if offset_s > 0.0 else 'behind'}"


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
    from host_sync.offload.pull import push_calibration

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
