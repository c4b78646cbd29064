"""The device's id, and its counts of scans and calibrations: they identify every bundle without the wall clock."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Final

import msgspec

from device.bundles.record import BundleId, Count, Record, decode_record, encode_record, read_small
from device.io.atomic import replace_file
from device.io.system import FILE_MODE

DEVICE_SCHEMA: Final = "retrograph.device/1"
DEVICE_FILE: Final = "device.json"
CALIBRATION_COUNT_FILE: Final = "calibration-count.json"
_REMEDY: Final = "restore a copy, or move it away and the store starts as a new device"
_BOOT_ID_FILE: Final = Path("/proc/sys/kernel/random/boot_id")


class DeviceState(Record, frozen=True, tag_field="schema", tag=DEVICE_SCHEMA):
    """The device's random id, made once, and its count of scans since, over all boots."""

    device_id: BundleId
    counter: Count


def new_device() -> DeviceState:
    """Return a device with a new random id and no scans."""
    return DeviceState(device_id=f"rg{secrets.token_hex(4)}", counter=0)


def read_device(root: Path) -> DeviceState | None:
    """Return the device that a store belongs to, None before the first start.

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


def start_device(root: Path) -> None:
    """Store a new device, with no scans and no calibrations. Errors as for `write_device`."""
    device = new_device()
    replace_file(root / CALIBRATION_COUNT_FILE, encode_record(device), FILE_MODE)
    write_device(root, device)


def count_scan(root: Path, state: DeviceState) -> int:
    """Return the number of the next scan, stored durably. Errors as for `write_device`."""
    write_device(root, msgspec.structs.replace(state, counter=state.counter + 1))
    return state.counter + 1


def count_calibration(root: Path, state: DeviceState) -> int:
    """Return the number of the next calibration, stored durably: calibrations take no numbers of scans.

    A store of a program that numbered both together goes on from their common count.

    Raises
    ------
    RecordError
        The file is damaged.
    OSError
        The disk refused; the old count is kept.
    """
    path = root / CALIBRATION_COUNT_FILE
    last = decode_record(read_small(path, _REMEDY), DeviceState, path, _REMEDY) if path.exists() else state
    replace_file(path, encode_record(msgspec.structs.replace(last, counter=last.counter + 1)), FILE_MODE)
    return last.counter + 1


def current_boot_id() -> str:
    """Return eight hex digits that identify this boot; random where the kernel has no boot id."""
    try:
        return _BOOT_ID_FILE.read_text().strip().replace("-", "")[:8]
    except OSError:
        return secrets.token_hex(4)
