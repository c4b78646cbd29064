"""`retroscan pair` and `retroscan import-inbox`: the device's side of pairing and of pushed calibrations."""

from __future__ import annotations

import argparse

from device.cli.console import open_store, print_line
from device.pairing.card import leave_device_card, take_host_cards
from device.pairing.exchange import PAIRING_PORT
from device.pairing_service.authorized_keys import SSHD_HOST_KEY, authorize
from device.pairing_service.service import OFFLOAD_USER, PairingSetup, how_to_call, open_pairing_window
from device.store.inbox import InboxItem
from device.store.store import BundleStore
from hal.clock import SystemClock


def import_inbox(store: BundleStore) -> list[InboxItem]:
    """Import the pushed calibrations and print the outcome of each."""
    items = store.import_inbox()
    for item in items:
        print_line(f"{item.name}: {item.refusal or 'imported'}")
    return items


def pair(options: argparse.Namespace) -> int:
    """Pair with a workstation, by a code or by cards."""
    store = open_store(options)
    port, user, host_key = (
        options.port or PAIRING_PORT,
        options.user or OFFLOAD_USER,
        options.host_key or SSHD_HOST_KEY,
    )
    setup = PairingSetup(port, options.ssh_port, user, host_key, options.keys)
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


def import_pushed(options: argparse.Namespace) -> int:
    """Import what workstations pushed."""
    store = open_store(options)
    items = import_inbox(store)
    imported = [item.name for item in items if item.refusal is None]
    if options.activate and imported:
        print_line(f"Calibration {store.activate(imported[-1]).calibration_id} is active.")
    return 2 if len(imported) < len(items) else 0
