"""`retroscan pair` and `retroscan receive`: the device's side of what a workstation does."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from device.bundle_store import BundleStore
from device.inbox import Delivery
from device.pairing.authorized_keys import SSHD_HOST_KEY, authorize
from device.pairing.opening import OFFLOAD_USER, PairingSetup, how_to_call, open_pairing_window
from device.pairing_card import leave_device_card, take_host_cards
from device.pairing_exchange import PAIRING_PORT
from device.store_location import default_store
from hal.clock import SystemClock

Say = Callable[[str], None]
MOST_PORT: Final = 65535


def add_offload_commands(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], folder: Callable[[str], Path], say: Say
) -> None:
    """Add the two commands to `retroscan`.

    folder : turns an argument into a path
    say : shows one line
    """
    pair = commands.add_parser("pair", help="let a workstation fetch scans: show a code for two minutes")
    pair.add_argument("--port", type=_port, default=PAIRING_PORT, help="where the workstation's call is awaited")
    pair.add_argument("--ssh-port", type=_port, default=22, help="where sshd listens")
    pair.add_argument("--user", default=OFFLOAD_USER, help="whom sshd lets in to fetch scans")
    pair.add_argument("--keys", type=folder, help="folder of the workstations' keys, as sshd's configuration names it")
    pair.add_argument("--host-key", type=folder, default=SSHD_HOST_KEY, help="sshd's public key")
    pair.add_argument("--card", type=folder, help="without a screen: take keys from this memory card, leave ours")
    pair.set_defaults(command=partial(_pair, say))

    receive = commands.add_parser("receive", help="take the calibrations that a workstation pushed")
    receive.add_argument("--activate", action="store_true", help="put the last one taken in force")
    receive.set_defaults(command=partial(_receive, say))


def _port(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= MOST_PORT):
        raise argparse.ArgumentTypeError(f"{text!r} is no port: give one of 1 to {MOST_PORT}")
    return int(text)


def take_inbox(store: BundleStore, say: Say) -> list[Delivery]:
    """What a workstation pushed and what became of it, said as well."""
    deliveries = store.take_inbox()
    for delivery in deliveries:
        say(f"{delivery.name}: {delivery.refusal or 'taken'}")
    return deliveries


def _pair(say: Say, options: argparse.Namespace) -> int:
    store = _store(options)
    setup = PairingSetup(options.port, options.ssh_port, options.user, options.host_key, options.keys)
    if options.card:
        card, hosts = setup.card(store), take_host_cards(options.card)
        for host in hosts:
            authorize(setup.authorized_keys(store), host)
        say(f"{len(hosts)} workstations authorized; this device's card is {leave_device_card(options.card, card)}")
        return 0
    with open_pairing_window(store, SystemClock(), setup) as window:
        say(how_to_call(window, setup, store))
        say(f"Paired with {window.wait().name}.")
    return 0


def _receive(say: Say, options: argparse.Namespace) -> int:
    store = _store(options)
    deliveries = take_inbox(store, say)
    taken = [delivery.name for delivery in deliveries if delivery.refusal is None]
    if options.activate and taken:
        say(f"Calibration {store.activate(taken[-1]).calibration_id} is active.")
    return 2 if len(taken) < len(deliveries) else 0


def _store(options: argparse.Namespace) -> BundleStore:
    return BundleStore(options.store or default_store(os.environ), SystemClock())
