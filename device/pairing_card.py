"""Pairing without a screen: each side leaves its card in a folder of the memory card, and takes the other's.

Whoever holds the memory card is trusted, as they hold the device too. Both sides read and write here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from device.disk_advice import explain_refusal
from device.durable import replace_file
from device.errors import RecordError, StoreError
from device.pairing_exchange import DeviceCard, HostCard
from device.records import decode_record, encode_record, read_small

FOLDER: Final = "retrograph-pair"
_DEVICE: Final = "device.json"
_MOST_HOSTS: Final = 16
_REMEDY: Final = "remove it and pair again"


def leave_host_card(memory_card: Path, host: HostCard) -> Path:
    """Where the workstation's card now lies.

    Raises
    ------
    StoreError
        The memory card cannot be written.
    """
    return _leave(memory_card, f"host-{host.name}.json", encode_record(host))


def take_host_cards(memory_card: Path) -> list[HostCard]:
    """The workstations whose cards lie there.

    Raises
    ------
    RecordError
        One is damaged; names it.
    """
    files = sorted((memory_card / FOLDER).glob("host-*.json"))[:_MOST_HOSTS]
    return [decode_record(read_small(path, _REMEDY), HostCard, path, _REMEDY) for path in files]


def leave_device_card(memory_card: Path, device: DeviceCard) -> Path:
    """Where the device's card now lies. Errors as for `leave_host_card`."""
    return _leave(memory_card, _DEVICE, encode_record(device))


def read_device_card(memory_card: Path) -> DeviceCard | None:
    """The device's card, None when it has left none yet. Errors as for `take_host_cards`."""
    path = memory_card / FOLDER / _DEVICE
    return decode_record(read_small(path, _REMEDY), DeviceCard, path, _REMEDY) if path.exists() else None


def _leave(memory_card: Path, name: str, data: bytes) -> Path:
    if not memory_card.is_dir():
        raise RecordError(f"{memory_card}: is no folder: name the mounted memory card")
    path = memory_card / FOLDER / name
    try:
        path.parent.mkdir(exist_ok=True)
        replace_file(path, data)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written {explain_refusal(error)}") from error
    return path
