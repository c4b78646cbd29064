"""How this instrument is called and reached: its name, its addresses, and the fingerprint by which to know it."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from pathlib import Path

from device.errors import RecordError
from device.pairing.authorized_keys import read_host_key
from device.pairing.opening import fingerprint_of


@dataclass(frozen=True, slots=True)
class NetworkFacts:
    """What to type on the workstation, and what to compare.

    addresses : IPv4, cable and Wi-Fi alike; empty without a network
    key_fingerprint : of sshd's key as OpenSSH prints it, or why there is none
    """

    host_name: str
    addresses: tuple[str, ...]
    key_fingerprint: str


def network_facts(host_key: Path) -> NetworkFacts:
    """The facts now."""
    return NetworkFacts(os.uname().nodename, _addresses(), _fingerprint(host_key))


def _addresses() -> tuple[str, ...]:
    """Addresses by which other machines may reach this one; the kernel names the source address of each route."""
    found = []
    for target in ("192.0.2.1", "10.55.0.1", "169.254.1.1"):
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.connect((target, 9))  # a datagram socket sends nothing by being connected
                address = str(probe.getsockname()[0])
        except OSError:
            continue
        if address not in found and not address.startswith("127."):
            found.append(address)
    return tuple(found)


def _fingerprint(host_key: Path) -> str:
    try:
        return fingerprint_of(read_host_key(host_key))
    except (RecordError, ValueError) as error:
        return str(error)
