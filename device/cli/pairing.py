"""`retroscan pair` and `retroscan import-inbox`: the device's side of pairing and of pushed calibrations."""

from __future__ import annotations

import argparse

from device.cli.console import Commands, folder_argument, open_store, port_argument, print_line
from device.pairing.card import leave_device_card, take_host_cards
from device.pairing.exchange import PAIRING_PORT
from device.pairing_service.authorized_keys import SSHD_HOST_KEY, authorize
from device.pairing_service.service import OFFLOAD_USER, PairingSetup, how_to_call, open_pairing_window
from device.store.inbox import InboxItem
from device.store.store import BundleStore
from hal.clock import SystemClock


def add_pairing_commands(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `pair` and `import-inbox` to `retroscan`."""
    pair = commands.add_parser("pair", help="show a code for two minutes; a workstation that has it may fetch scans")
    pair.add_argument("--port", type=port_argument, default=PAIRING_PORT, help="port that listens for the workstation")
    pair.add_argument("--ssh-port", type=port_argument, default=22, help="port of sshd")
    pair.add_argument("--user", default=OFFLOAD_USER, help="account that workstations log in to")
    pair.add_argument("--keys", type=folder_argument, help="folder of authorized keys named in sshd's configuration")
    pair.add_argument("--host-key", type=folder_argument, default=SSHD_HOST_KEY, help="sshd's public key")
    pair.add_argument("--card", type=folder_argument, help="exchange keys through this memory card instead of a code")
    pair.set_defaults(command=_pair)

    inbox = commands.add_parser("import-inbox", help="import the calibrations that a workstation pushed")
    inbox.add_argument("--activate", action="store_true", help="activate the last one imported")
    inbox.set_defaults(command=_import_inbox)


def import_inbox(store: BundleStore) -> list[InboxItem]:
    """Import the pushed calibrations and print the outcome of each."""
    items = store.import_inbox()
    for item in items:
        print_line(f"{item.name}: {item.refusal or 'imported'}")
    return items


def _pair(options: argparse.Namespace) -> int:
    store = open_store(options)
    setup = PairingSetup(options.port, options.ssh_port, options.user, options.host_key, options.keys)
    if options.card:
        card, hosts = setup.card(store), take_host_cards(options.card)
        for host in hosts:
            authorize(setup.authorized_keys(store), host)
        left = leave_device_card(options.card, card)
        print_line(f"{len(hosts)} workstations authorized; this device's card is {left}")
        return 0
    with open_pairing_window(store, SystemClock(), setup) as window:
        print_line(how_to_call(window, setup, store))
        print_line(f"Paired with {window.wait().name}.")
    return 0


def _import_inbox(options: argparse.Namespace) -> int:
    store = open_store(options)
    items = import_inbox(store)
    imported = [item.name for item in items if item.refusal is None]
    if options.activate and imported:
        print_line(f"Calibration {store.activate(imported[-1]).calibration_id} is active.")
    return 2 if len(imported) < len(items) else 0
