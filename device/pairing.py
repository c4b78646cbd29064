"""Pairing: both sides show a short code made from both cards, and so from both SSH keys; a person compares the codes.

This is numeric comparison, as Bluetooth pairs two screens: the workstation commits to a random number, the device sends
its own, the workstation opens the commitment, and the code is a hash of both cards and both numbers. Someone in between
must fix what each side hashes before the last number is known, so each code that a person compares is one guess in
10**6. Nothing here is secret; SSH itself proves at every connection that a side holds the key on its card.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
import socket
import time
from pathlib import Path
from typing import Annotated, Final, TypeVar

import msgspec

from device.bundles.record import BundleId, Record, decode_record, encode_record
from device.errors import RecordError, StoreError
from device.io.folder import Folder
from device.io.system import explain_os_error

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


# Records over a socket, one JSON line each, limited in time and size: the channel of both sides of pairing.

RecordT = TypeVar("RecordT", bound=Record)


class PairingChannel:
    """One connection; every method raises `RecordError` when the other side is gone, slow or sends something else.

    Parameters
    ----------
    connection : closed by the caller
    within_s : time limit of the whole conversation, s
    """

    def __init__(self, connection: socket.socket, within_s: float) -> None:
        self._connection = connection
        self._unread = b""
        self.limit(within_s)

    def limit(self, within_s: float) -> None:
        """Give the rest of the conversation a new time limit, s."""
        self._end_s = time.monotonic() + within_s

    def send(self, record: Record) -> None:
        """Send one record."""
        try:
            self._connection.settimeout(self._left_s())
            self._connection.sendall(msgspec.json.encode(record) + b"\n")
        except OSError as error:
            raise RecordError(f"pairing: the other side is gone ({error}): start again") from error

    def receive(self, kind: type[RecordT]) -> RecordT:
        """Return the next record, which must be of that kind."""
        while b"\n" not in self._unread:
            try:
                self._connection.settimeout(self._left_s())
                some = self._connection.recv(MAX_MESSAGE_BYTES)
            except OSError as error:
                raise RecordError(f"pairing: the other side is silent ({error}): start again") from error
            self._unread += some
            if not some or len(self._unread) > MAX_MESSAGE_BYTES:
                raise RecordError("pairing: the other side closed the connection: start again")
        line, _, self._unread = self._unread.partition(b"\n")
        return decode_record(line, kind, "pairing", "start again")

    def _left_s(self) -> float:
        left_s = self._end_s - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError("too slow")
        return left_s


# Pairing without a screen: each side leaves its card in a folder of the memory card and reads the other's.
#
# The holder of the memory card is trusted as the device's owner, but the card's file system is not: links are not
# followed, and only small regular files are read.

FOLDER: Final = "retrograph-pair"
_DEVICE: Final = "device.json"
_MAX_HOSTS: Final = 16
_MAX_CARD_BYTES: Final = 1 << 16
_REMEDY: Final = "remove it and pair again"

CardT = TypeVar("CardT", bound=Record)


def leave_host_card(memory_card: Path, host: HostCard) -> Path:
    """Leave the workstation's card on the memory card; returns its path.

    Raises
    ------
    StoreError
        The memory card cannot be written.
    """
    return _leave(memory_card, f"host-{host.name}.json", encode_record(host))


def take_host_cards(memory_card: Path) -> list[HostCard]:
    """Return the workstations whose cards are on the memory card.

    Raises
    ------
    RecordError
        One is damaged; names it.
    """
    try:
        with Folder(memory_card) as folder:
            names = [entry.name for entry in folder.entries(FOLDER)]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise _unreadable(memory_card / FOLDER, error) from error
    files = [name for name in names if name.startswith("host-") and name.endswith(".json")][:_MAX_HOSTS]
    cards = (_read(memory_card, name, HostCard) for name in files)
    return [card for card in cards if card is not None]


def leave_device_card(memory_card: Path, device: DeviceCard) -> Path:
    """Leave the device's card on the memory card; returns its path. Errors as for `leave_host_card`."""
    return _leave(memory_card, _DEVICE, encode_record(device))


def read_device_card(memory_card: Path) -> DeviceCard | None:
    """Return the device's card, None when it has left none yet. Errors as for `take_host_cards`."""
    return _read(memory_card, _DEVICE, DeviceCard)


def _read(memory_card: Path, name: str, kind: type[CardT]) -> CardT | None:
    path = memory_card / FOLDER / name
    try:
        with Folder(memory_card) as folder:
            data = folder.read(f"{FOLDER}/{name}", _MAX_CARD_BYTES)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unreadable(path, error) from error
    return decode_record(data, kind, path, _REMEDY)


def _leave(memory_card: Path, name: str, data: bytes) -> Path:
    path = memory_card / FOLDER / name
    if not memory_card.is_dir():
        raise RecordError(f"{memory_card}: is no folder: name the mounted memory card")
    try:
        with Folder(memory_card) as folder:
            folder.make_folder(FOLDER)
            folder.write(f"{FOLDER}/{name}", data)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written {explain_os_error(error)}") from error
    return path


def _unreadable(path: Path, error: OSError) -> RecordError:
    return RecordError(f"{path}: cannot be read ({error.strerror or error}): {_REMEDY}")


def fingerprint_of(public_key: str) -> str:
    """Return a key's fingerprint as OpenSSH shows it, such as "SHA256:mVPwvezndPv/ARoIadVY98vAC0g"."""
    digest = hashlib.sha256(base64.b64decode(public_key.split()[1])).digest()
    return "SHA256:" + base64.b64encode(digest).decode().rstrip("=")
