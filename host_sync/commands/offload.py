"""`retrosync discover`, `pair`, `pull`, `sync`, `status`, `push-calibration`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from cyclopts import App
from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from device.pairing_exchange import PAIRING_PORT
from host_sync.commands.console import BAD_INPUT, CONNECTION, DONE, PARTLY, Folder, complain, say
from host_sync.errors import PairingError, SourceError
from host_sync.library import Library, default_library
from host_sync.offload.directory import DirectorySource
from host_sync.offload.ledger import PullReport
from host_sync.offload.opening import MOST_PORT, Address, is_folder, open_device, open_source
from host_sync.offload.paired_devices import PairedDevices, default_devices_folder, this_host
from host_sync.offload.pull import PullProgress, pull
from host_sync.offload.receipting import Vouch
from host_sync.offload.sync import sync, sync_one, utc_now

CLOCK_SEEN_S: Final = 2.0
UNITS_S: Final = (("years", 31_557_600.0), ("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0), ("s", 1.0))

Show = Callable[[str, PullProgress], None]


def register(app: App) -> None:
    """Add the commands of this theme."""
    app.command(pull_command, name="pull")
    app.command(sync_command, name="sync")
    app.command(discover_command, name="discover")
    app.command(pair_command, name="pair")
    app.command(status_command, name="status")
    app.command(push_command, name="push-calibration")


def pull_command(source: str, *, library: Folder | None = None, at: str | None = None) -> int:
    """Copy every scan and calibration that the library lacks, prove each by re-reading it, and leave receipts.

    Parameters
    ----------
    source: A paired device, or a card, mount or folder that holds a device's store.
    library: Where to; ~/Retrograph when not given.
    at: Where the device is now, HOST or HOST:PORT, when it is not where it was paired.
    """
    target = Library(library or default_library())
    devices = _devices()
    address = Address.parse(at) if at else None
    with _progress() as show:
        if is_folder(source):
            opened = DirectorySource(Path(source))
            report = pull(opened, target, lambda state: show(opened.name, state), Vouch(this_host(), utc_now))
        else:
            device = devices.find(source)
            with target.writing():
                report = sync_one(
                    device,
                    target,
                    devices,
                    lambda device: open_device(device, devices, address),
                    lambda state: show(device.device_id, state),
                )
    return _tell(report, str(target.root))


def sync_command(*names: str, library: Folder | None = None) -> int:
    """Pull from every paired device, or from those named, side by side.

    Parameters
    ----------
    names: Paired devices; all when none is named.
    library: Where to; ~/Retrograph when not given.
    """
    target, devices = Library(library or default_library()), _devices()
    wanted = [devices.find(name) for name in names] or devices.all()
    if not wanted:
        raise PairingError("no device is paired: `retrosync pair HOST` first")
    with _progress() as show:
        outcomes = sync(
            wanted,
            target,
            devices,
            lambda device: open_device(device, devices),
            lambda device, state: show(device.device_id, state),
        )
    codes = []
    for device, outcome in zip(wanted, outcomes, strict=True):
        if isinstance(outcome, PullReport):
            codes.append(_tell(outcome, f"{device.device_id}, {target.root}"))
        else:
            codes.append(complain(outcome, CONNECTION if isinstance(outcome, SourceError) else BAD_INPUT))
    return PARTLY if DONE in codes and max(codes) > DONE else max(codes)


def discover_command(*, seconds: float = 3.0) -> int:
    """List the devices that announce themselves on the local network.

    Parameters
    ----------
    seconds: How long to listen.
    """
    from host_sync.offload.discovery import discover

    found = discover(seconds)
    for one in found:
        say(f"{one.name}  {one.host}:{one.port}  {' '.join(one.addresses)}")
    if not found:
        return complain("no device was heard: check cable or network, or name its address to `pair`", CONNECTION)
    return DONE


def pair_command(
    host: str | None = None,
    *,
    code: str | None = None,
    card: Folder | None = None,
    port: int = PAIRING_PORT,
    replace: bool = False,
) -> int:
    """Pair with a device whose window is open, by the code on its screen; or by files on its memory card.

    Parameters
    ----------
    host: Where the device is reached.
    code: What its screen shows; asked for when not given.
    card: Its mounted memory card, when it has no screen: run this, start the device with it, run this again.
    port: Where its window listens.
    replace: Accept that a known device has a new key, because you set it up anew.
    """
    from host_sync.offload import pairing

    devices = _devices()
    own = pairing.own_card(devices, this_host())
    if card is not None:
        device = pairing.pair_by_card(card, own, host)
        if device is None:
            say(f"This workstation's key waits on {card}: start the device with it, then run this again.")
            return DONE
    elif host:
        device = pairing.pair_over_network(host, _checked_port(port), code or _asked_code(), own)
    else:
        raise PairingError("name the device's address, or --card with its memory card")
    pairing.keep(devices, device, replace=replace)
    say(f"Paired with {device.device_id} at {device.host}:{device.port}.")
    return DONE


def _asked_code() -> str:
    try:
        return input("Code on the device's screen: ")
    except EOFError as error:
        raise PairingError("no code was typed: repeat on a terminal, or give it with --code") from error


def _checked_port(port: int) -> int:
    if not 1 <= port <= MOST_PORT:
        raise PairingError(f"--port {port}: is no port: give one of 1 to {MOST_PORT}")
    return port


def status_command() -> int:
    """Say which devices are paired and how the last sync with each went."""
    devices = _devices()
    known = devices.all()
    for device in known:
        state = devices.sync_state(device.device_id)
        say(f"{device.device_id}  {device.host}:{device.port}")
        if state is None:
            say("  never synced")
            continue
        clock = _clock_in_words(state.clock_offset_s)
        say(f"  synced {state.synced:%Y-%m-%d %H:%M} UTC: {state.verified} verified, {state.failed} failed; {clock}")
    if not known:
        say("No device is paired: `retrosync pair HOST` makes one known.")
    return DONE


def _clock_in_words(offset_s: float | None) -> str:
    """How far a device's clock was off; it is seen to a second or so."""
    if offset_s is None:
        return "its clock was not seen"
    if abs(offset_s) < CLOCK_SEEN_S:
        return "its clock was right"
    unit, length_s = next((name, size_s) for name, size_s in UNITS_S if abs(offset_s) >= 2 * size_s)
    return f"its clock was {abs(offset_s) / length_s:.0f} {unit} {'ahead' if offset_s > 0.0 else 'behind'}"


def push_command(source: str, calibration: str, *, library: Folder | None = None, at: str | None = None) -> int:
    """Put a calibration of the library into a device's inbox; the device proves it when it takes it.

    Parameters
    ----------
    source: A paired device, or the folder of a store.
    calibration: Its id, or the beginning or end of it.
    library: Where from; ~/Retrograph when not given.
    at: Where the device is now, HOST or HOST:PORT.
    """
    from host_sync.offload.push import push_calibration

    bundle = Library(library or default_library()).find_calibration(calibration)
    with open_source(source, _devices(), Address.parse(at) if at else None) as opened:
        push_calibration(opened, bundle)
    say(f"{bundle.calibration_id} lies in the inbox of {source}: `retroscan receive --activate` takes it there.")
    return DONE


def _devices() -> PairedDevices:
    return PairedDevices(default_devices_folder(os.environ))


def _tell(report: PullReport, where: str) -> int:
    """Say what a pull did; returns the exit code."""
    total = report.here + len(report.failed)
    say(f"{len(report.copied)} copied and verified, {len(report.already_there)} already there: {where}")
    say(f"{report.here} of {total} verified")
    for scan in report.without_calibration:
        say(f"Note: scan {scan} has no calibration here.")
    if report.unreceipted is not None:
        say(f"Note: no receipts were left, so the device keeps its scans: {report.unreceipted}")
    for failure in report.failed:
        complain(f"{failure.bundle_id}: {failure.reason}", PARTLY)
    if report.lost is not None:
        return complain(report.lost, CONNECTION)
    return DONE if report.complete else PARTLY


@contextmanager
def _progress() -> Iterator[Show]:
    """A bar a source, on stderr, with rate and time left."""
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        bars: dict[str, TaskID] = {}

        def show(source: str, state: PullProgress) -> None:
            if source not in bars:
                bars[source] = progress.add_task(source, total=None)
            words = f"{source}: {state.bundle_id}"
            progress.update(bars[source], description=words, completed=state.done_bytes, total=state.total_bytes)

        yield show
