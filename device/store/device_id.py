"""The device's id, and its counts of scans and calibrations: they identify every bundle without the wall clock."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Final

import msgspec

from device.bundles.bundle import BundleKind
from device.bundles.record import BundleId, Count, Record
from device.io.system import FILE_MODE
from device.store.choices import RecordFile

_REMEDY: Final = "restore a copy, or move it away and the store starts as a new device"
_BOOT_ID_FILE: Final = Path("/proc/sys/kernel/random/boot_id")


class DeviceState(Record, frozen=True, tag_field="schema", tag="retrograph.device/1"):
    """The device's random id, made once, and its count of scans since, over all boots."""

    device_id: BundleId
    counter: Count


DEVICE: Final = RecordFile(DeviceState, "device.json", _REMEDY, FILE_MODE)
"""The device that a store belongs to; its file is absent before the first start."""

CALIBRATION_COUNT: Final = RecordFile(DeviceState, "calibration-count.json", _REMEDY, FILE_MODE)


def start_device(root: Path) -> None:
    """Store a new device with a random id, no scans and no calibrations. Errors as for `RecordFile.write`."""
    device = DeviceState(device_id=f"rg{secrets.token_hex(4)}", counter=0)
    CALIBRATION_COUNT.write(root, device)
    DEVICE.write(root, device)


def count_bundle(root: Path, kind: BundleKind, state: DeviceState) -> int:
    """Return the number of the next bundle, stored durably: calibrations take no numbers of scans.

    A store of a program that numbered both together goes on from their common count. Errors as for `RecordFile`.
    """
    file = DEVICE if kind == "scans" else CALIBRATION_COUNT
    last = file.read(root) or state
    file.write(root, msgspec.structs.replace(last, counter=last.counter + 1))
    return last.counter + 1


def current_boot_id() -> str:
    """Return eight hex digits that identify this boot; random where the kernel has no boot id."""
    try:
        return _BOOT_ID_FILE.read_text().strip().replace("-", "")[:8]
    except OSError:
        return secrets.token_hex(4)
