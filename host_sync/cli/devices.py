"""`retrosync pair` and `status`: the devices of this workstation."""

from __future__ import annotations

from typing import Final

from device.command_line import Folder, print_json
from device.pairing.exchange import PAIRING_PORT
from host_sync.cli.console import CONNECTION, DONE, print_error, print_line
from host_sync.errors import PairingError, SourceError
from host_sync.offload.paired_devices import PairedDevices, default_devices_folder, this_host
from host_sync.offload.resolve import MAX_PORT

CLOCK_SEEN_S: Final = 2.0
LISTEN_S: Final = 3.0
UNITS_S: Final = (("years", 31_557_600.0), ("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0), ("s", 1.0))


def known_devices() -> PairedDevices:
    """The devices in this user's settings."""
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
    from host_sync.offload import pairing

    devices = known_devices()
    own = pairing.own_card(devices, this_host())
    if card is not None:
        device = pairing.pair_by_card(card, own, host)
        if device is None:
            print_line(f"This workstation's key is on {card} now: start the device with it, then run this again.")
            return DONE
    else:
        device = pairing.pair_over_network(host or _only_announced(), _checked_port(port), own, _same_code)
    pairing.keep(devices, device, replace=replace)
    print_line(f"Paired with {device.device_id} at {device.host}:{device.port}.")
    return DONE


def _only_announced() -> str:
    """Return the address of the one device that announces itself on the local network."""
    from host_sync.offload import discovery

    print_line("Looking for the device on this network ...")
    found = discovery.discover(LISTEN_S)
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
    """List the paired devices and how the last pull from each went; with --network, who announces itself.

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
    from host_sync.offload.discovery import discover

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
