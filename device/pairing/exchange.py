"""Pairing: both sides show a short code made from both cards, and so from both SSH keys; a person compares the codes.

This is numeric comparison, as Bluetooth pairs two screens: the workstation commits to a random number, the device sends
its own, the workstation opens the commitment, and the code is a hash of both cards and both numbers. Someone in between
must fix what each side hashes before the last number is known, so each code that a person compares is one guess in
10**6. Nothing here is secret; SSH itself proves at every connection that a side holds the key on its card.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from typing import Annotated, Final

import msgspec

from device.bundles.record import BundleId, Record

CODE_DIGITS: Final = 6
PAIRING_PORT: Final = 8022
MAX_MESSAGE_BYTES: Final = 8192
_CONTEXT: Final = "retrograph pairing 3"

Hash = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}(?!\n)$")]
"""32 bytes in hex: a random number, or a hash."""

SshPublicKey = Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9@.-]{4,60} [A-Za-z0-9+/]{32,1200}={0,2}(?!\n)$")]
"""Kind and key as OpenSSH writes them, no options and no comment."""


class HostCard(Record, frozen=True, tag_field="schema", tag="retrograph.pair-host/2"):
    """A workstation's card: its name and its public key."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9._-]{1,64}(?!\n)$")]
    public_key: SshPublicKey


class DeviceCard(Record, frozen=True, tag_field="schema", tag="retrograph.pair-device/2"):
    """A device's card: its id, user and port for its files, and its host key."""

    device_id: BundleId
    user: Annotated[str, msgspec.Meta(pattern=r"^[a-z_][a-z0-9_-]{0,31}(?!\n)$")]
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)]
    host_key: SshPublicKey


class Call(Record, frozen=True, tag_field="schema", tag="retrograph.pair-call/3"):
    """The workstation's first message: its card, and its commitment to a number."""

    card: HostCard
    commitment: Hash


class Answer(Record, frozen=True, tag_field="schema", tag="retrograph.pair-answer/3"):
    """The device's message: its card and its number."""

    card: DeviceCard
    number: Hash


class Opening(Record, frozen=True, tag_field="schema", tag="retrograph.pair-opening/3"):
    """The workstation's second message: the number of its commitment."""

    number: Hash


class Accepted(Record, frozen=True, tag_field="schema", tag="retrograph.pair-accepted/3"):
    """The device's last message: its button confirmed the code, and the workstation's key is installed."""


def draw_number() -> str:
    """Return a new random number for one conversation."""
    return secrets.token_hex(32)


def commitment_to(card: HostCard, number: str) -> str:
    """Return the hash by which a workstation commits to its card and its number."""
    return _hash(card, number)


def opens(call: Call, opening: Opening) -> bool:
    """Return whether the number is the one that the workstation committed to."""
    return hmac.compare_digest(call.commitment, commitment_to(call.card, opening.number))


def code_of(host: HostCard, device: DeviceCard, host_number: str, device_number: str) -> str:
    """Return the code that both screens show, in two halves, such as "042 917"."""
    number = int(_hash(host, device, host_number, device_number), 16) % 10**CODE_DIGITS
    digits = f"{number:0{CODE_DIGITS}d}"
    return f"{digits[: CODE_DIGITS // 2]} {digits[CODE_DIGITS // 2 :]}"


def _hash(*parts: Record | str) -> str:
    return hashlib.sha256(msgspec.json.encode((_CONTEXT, *parts))).hexdigest()
