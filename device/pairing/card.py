"""Pairing without a screen: each side leaves its card in a folder of the memory card and reads the other's.

The holder of the memory card is trusted as the device's owner, but the card's file system is not: links are not
followed, and only small regular files are read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, TypeVar

from device.bundles.record import Record, decode_record, encode_record
from device.errors import RecordError, StoreError
from device.io.folder import Folder
from device.io.os_errors import explain_os_error
from device.pairing.exchange import DeviceCard, HostCard

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
    """The workstations whose cards are on the memory card.

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
    """The device's card, None when it has left none yet. Errors as for `take_host_cards`."""
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
