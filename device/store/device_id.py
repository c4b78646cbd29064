"""The device's id and its count of presses: they identify every bundle without the wall clock."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Final

import msgspec

from device.bundles.record import BundleId, Count, Record, decode_record, encode_record, read_small
from device.io.atomic import replace_file
from device.io.permissions import FILE_MODE

DEVICE_SCHEMA: Final = "retrograph.device/1"
DEVICE_FILE: Final = "device.json"
_REMEDY: Final = "restore a copy, or move it away and the store starts as a new device"
_BOOT_ID_FILE: Final = Path("/proc/sys/kernel/random/boot_id")


class DeviceState(Record, frozen=True, tag_field="schema", tag=DEVICE_SCHEMA):
    """The device's random id, made once, and its count of presses since, over all boots."""

    device_id: BundleId
    counter: Count


def new_device() -> DeviceState:
    """A device with a new random id and no presses."""
    return DeviceState(device_id=f"rg{secrets.token_hex(4)}", counter=0)


def read_device(root: Path) -> DeviceState | None:
    """The device that a store belongs to, None before the first start.

    Raises
    ------
    RecordError
        The file is damaged.
    """
    path = root / DEVICE_FILE
    return decode_record(read_small(path, _REMEDY), DeviceState, path, _REMEDY) if path.exists() else None


def write_device(root: Path, state: DeviceState) -> None:
    """Store the device's state durably.

    Raises
    ------
    OSError
        The disk refused; the old state is kept.
    """
    replace_file(root / DEVICE_FILE, encode_record(state), FILE_MODE)


def count_press(state: DeviceState) -> DeviceState:
    """The state after one more press."""
    return msgspec.structs.replace(state, counter=state.counter + 1)


def current_boot_id() -> str:
    """Eight hex digits that identify this boot; random where the kernel has no boot id."""
    try:
        return _BOOT_ID_FILE.read_text().strip().replace("-", "")[:8]
    except OSError:
        return secrets.token_hex(4)
