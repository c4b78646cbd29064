"""`retroscan pair` and `calibrations import-inbox`: the device's side of pairing and of pushed calibrations."""

from __future__ import annotations

import select
import sys
from typing import Final

from device.cli.console import Given, Port, open_store, print_line
from device.command_line import Folder
from device.errors import PairingRefused
from device.pairing.exchange import PAIRING_PORT, leave_device_card, take_host_cards
from device.pairing_service.service import (
    OFFLOAD_USER,
    SSHD_HOST_KEY,
    PairingSetup,
    authorize,
    describe_code,
    how_to_call,
    open_pairing_window,
)
from device.pairing_service.window import PairingWindow
from device.store.inbox import InboxItem
from device.store.store import BundleStore
from hal.clock import SystemClock

POLL_S: Final = 0.2


def import_inbox(store: BundleStore) -> list[InboxItem]:
    """Import the pushed calibrations and print the outcome of each."""
    items = store.import_inbox()
    for item in items:
        print_line(f"{item.name}: {item.refusal or 'imported'}")
    return items


def pair(
    *,
    port: Port = PAIRING_PORT,
    ssh_port: Port = 22,
    user: str = OFFLOAD_USER,
    keys: Folder | None = None,
    host_key: Folder = SSHD_HOST_KEY,
    card: Folder | None = None,
    options: Given,
) -> int:
    """Let a workstation pair within two minutes; it shows the same code as this device.

    Parameters
    ----------
    port
        Port that listens for the workstation.
    ssh_port
        Port of sshd.
    user
        Account that workstations log in to.
    keys
        Folder of authorized keys named in sshd's configuration.
    host_key
        sshd's public key.
    card
        Exchange keys through this memory card instead of the network.
    """
    store = open_store(options)
    setup = PairingSetup(port, ssh_port, user, host_key, keys)
    if card:
        own, hosts = setup.card(store), take_host_cards(card)
        for host in hosts:
            authorize(setup.authorized_keys(store), host)
        left = leave_device_card(card, own)
        print_line(f"{len(hosts)} workstations authorized; this device's card is {left}")
        return 0
    with open_pairing_window(store, SystemClock(), setup) as window:
        print_line(how_to_call(window, setup, store))
        _confirm_codes(window)
        print_line(f"Paired with {window.wait().name}.")
    return 0


def _confirm_codes(window: PairingWindow) -> None:
    """Print each code, and confirm it when its digits are typed, until the window is closed."""
    printed = None
    while window.outcome is None:
        shown = window.shown
        if shown is not None and shown is not printed:
            print_line(describe_code(shown, "type the code here"))
        printed = shown
        if select.select([sys.stdin], [], [], POLL_S)[0]:
            line = sys.stdin.readline()
            if not line:
                raise PairingRefused("nobody can confirm a code here: run this in a terminal, or hold the button")
            if shown is not None and "".join(line.split()) == "".join(shown.code.split()):
                window.confirm(shown.code)
            else:
                print_line("That is not the code: nothing is confirmed.")


def import_pushed(*, activate: bool = False, options: Given) -> int:
    """Import the calibrations that a workstation pushed.

    Parameters
    ----------
    activate
        Activate the last one imported.
    """
    store = open_store(options)
    items = import_inbox(store)
    imported = [item.name for item in items if item.refusal is None]
    if activate and imported:
        print_line(f"Calibration {store.activate(imported[-1]).calibration_id} is active.")
    return 2 if len(imported) < len(items) else 0
