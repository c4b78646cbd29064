"""`retroscan pair` and `retroscan receive`: the device's side of what a workstation does."""

from __future__ import annotations

import argparse
import os
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path

from device.bundle_store import BundleStore
from device.errors import PairingRefused
from device.inbox import Delivery
from device.pairing.authorized_keys import SSHD_HOST_KEY, authorize, read_host_key
from device.pairing.window import wait_for_host
from device.pairing_card import leave_device_card, take_host_cards
from device.pairing_exchange import CODE_DIGITS, PAIRING_PORT, DeviceCard, draw_code
from device.store_location import default_store
from hal.clock import SystemClock

Say = Callable[[str], None]


def add_offload_commands(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], folder: Callable[[str], Path], say: Say
) -> None:
    """Add the two commands to `retroscan`.

    folder : turns an argument into a path
    say : shows one line
    """
    pair = commands.add_parser("pair", help="let a workstation fetch scans: show a code for two minutes")
    pair.add_argument("--port", type=int, default=PAIRING_PORT, help="where the workstation's call is awaited")
    pair.add_argument("--ssh-port", type=int, default=22, help="where sshd listens")
    pair.add_argument("--user", default="retrosync", help="whom sshd lets in to fetch scans")
    pair.add_argument("--keys", type=folder, help="folder of the workstations' keys, as sshd's configuration names it")
    pair.add_argument("--host-key", type=folder, default=SSHD_HOST_KEY, help="sshd's public key")
    pair.add_argument("--card", type=folder, help="without a screen: take keys from this memory card, leave ours")
    pair.set_defaults(command=partial(_pair, say))

    receive = commands.add_parser("receive", help="take the calibrations that a workstation pushed")
    receive.add_argument("--activate", action="store_true", help="put the last one taken in force")
    receive.set_defaults(command=partial(_receive, say))


def take_inbox(store: BundleStore, say: Say) -> list[Delivery]:
    """What a workstation pushed and what became of it, said as well."""
    deliveries = store.take_inbox()
    for delivery in deliveries:
        say(f"{delivery.name}: {delivery.refusal or 'taken'}")
    return deliveries


def _pair(say: Say, options: argparse.Namespace) -> int:
    store = _store(options)
    keys = (options.keys or store.root.with_name(f"{store.root.name}-pairing")) / "authorized_keys"
    card = DeviceCard(
        device_id=store.device_id, user=options.user, port=options.ssh_port, host_key=read_host_key(options.host_key)
    )
    if options.card:
        hosts = take_host_cards(options.card)
        for host in hosts:
            authorize(keys, host)
        say(f"{len(hosts)} workstations authorized; this device's card is {leave_device_card(options.card, card)}")
        return 0
    code, half = draw_code(), CODE_DIGITS // 2
    listening = _listen(options.port)
    say(f"Code {code[:half]} {code[half:]}, for two minutes. On the workstation: retrosync pair {os.uname().nodename}")
    host = wait_for_host(listening, code, card, lambda host: authorize(keys, host))
    say(f"Paired with {host.name}.")
    return 0


def _listen(port: int) -> socket.socket:
    try:
        return socket.create_server(("", port))
    except (OSError, OverflowError) as error:
        raise PairingRefused(f"port {port}: cannot be listened on ({error}): name another") from error


def _receive(say: Say, options: argparse.Namespace) -> int:
    store = _store(options)
    deliveries = take_inbox(store, say)
    taken = [delivery.name for delivery in deliveries if delivery.refusal is None]
    if options.activate and taken:
        say(f"Calibration {store.activate(taken[-1]).calibration_id} is active.")
    return 2 if len(taken) < len(deliveries) else 0


def _store(options: argparse.Namespace) -> BundleStore:
    return BundleStore(options.store or default_store(os.environ), SystemClock())
