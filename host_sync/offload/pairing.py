"""The workstation's side of pairing: exchange cards, let a person compare the codes, store the device's key."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Final

import asyncssh

from device.errors import DeviceError, RecordError
from device.pairing.exchange import (
    Accepted,
    Answer,
    Call,
    DeviceCard,
    HostCard,
    Opening,
    PairingChannel,
    code_of,
    commitment_to,
    draw_number,
    leave_host_card,
    read_device_card,
)
from host_sync.errors import HostError, PairingError, SourceError
from host_sync.offload.paired_devices import PairedDevice, PairedDevices

CONVERSATION_S: Final = 10.0
CONFIRMATION_S: Final = 120.0
"""Time for the person who confirms the code on the device."""


def new_private_key() -> bytes:
    """A new private key in OpenSSH's format."""
    return asyncssh.generate_private_key("ssh-ed25519").export_private_key()


def own_card(devices: PairedDevices, name: str) -> HostCard:
    """This workstation's card; its key is generated when absent."""
    path = devices.private_key(new_private_key)
    try:
        key = asyncssh.read_private_key(path)
    except (OSError, asyncssh.KeyImportError) as error:
        raise HostError(f"{path}: holds no private key: remove it and pair every device again") from error
    kind, encoded = key.export_public_key().decode().split()[:2]
    return HostCard(name=re.sub(r"[^A-Za-z0-9._-]", "-", name)[:64] or "workstation", public_key=f"{kind} {encoded}")


def pair_over_network(host: str, port: int, card: HostCard, same_code: Callable[[str], bool]) -> PairedDevice:
    """Pair with the device that listens there.

    same_code : asks the person whether the device shows that code

    Raises
    ------
    SourceError
        Nothing listens there.
    PairingError
        The codes differ, the device did not accept, or something else answered.
    """
    try:
        connection = socket.create_connection((host, port), timeout=CONVERSATION_S)
    except (OSError, UnicodeError) as error:
        raise SourceError(
            f"{host}:{port}: no device waits there for pairing ({error}): open its window and check the address"
        ) from error
    number = draw_number()
    with closing(connection):
        channel = PairingChannel(connection, CONVERSATION_S)
        try:
            channel.send(Call(card=card, commitment=commitment_to(card, number)))
            answer = channel.receive(Answer)
            channel.send(Opening(number=number))
        except RecordError as error:
            raise PairingError(
                f"{host}: was not paired, the device is busy with other callers or did not answer ({error}): repeat"
            ) from error
        if not same_code(code_of(card, answer.card, number, answer.number)):
            raise PairingError(f"{host}: was not paired: if the codes differ, something else answers in its place")
        channel.limit(CONFIRMATION_S)
        try:
            channel.receive(Accepted)
        except RecordError as error:
            raise PairingError(
                f"{host}: was not paired, the code was not confirmed on the device ({error}): repeat"
            ) from error
    return _paired(answer.card, host)


def pair_by_card(memory_card: Path, card: HostCard, host: str | None) -> PairedDevice | None:
    """The device whose card is on a memory card; None when it has left none yet. Ours is left there in any case.

    host : the device's address; its id under ".local" when None

    Raises
    ------
    PairingError
        The memory card cannot be read or written.
    """
    try:
        device = read_device_card(memory_card)
        leave_host_card(memory_card, card)
    except DeviceError as error:
        raise PairingError(str(error)) from error
    return None if device is None else _paired(device, host or f"{device.device_id}.local")


def keep(devices: PairedDevices, device: PairedDevice, *, replace: bool) -> None:
    """Store a paired device; a changed key, or another device at a known address, only with `replace`.

    replace : the device was set up again; its old record is forgotten

    Raises
    ------
    PairingError
        Its key or its id has changed and `replace` is False.
    """
    known = devices.all()
    before = next((one for one in known if one.device_id == device.device_id), None)
    if before is not None and before.host_key != device.host_key and not replace:
        raise PairingError(
            f"{device.device_id}: presents another host key than when it was paired: if you set it up again, "
            "pair it with --replace; otherwise something else answers in its place"
        )
    others = [one for one in known if one != before and (one.host, one.port) == (device.host, device.port)]
    if others and not replace:
        raise PairingError(
            f"{device.host}: is {device.device_id} and was {others[0].device_id}: if you set it up again, pair it with "
            "--replace and the old record is forgotten; two devices need two addresses"
        )
    for other in others:
        devices.forget(other.device_id)
    devices.save(device)


def _paired(card: DeviceCard, host: str) -> PairedDevice:
    try:
        asyncssh.import_public_key(card.host_key)
    except asyncssh.KeyImportError as error:
        raise PairingError(f"{host}: its host key cannot be read ({error}): check its sshd") from error
    return PairedDevice(device_id=card.device_id, host=host, port=card.port, user=card.user, host_key=card.host_key)
