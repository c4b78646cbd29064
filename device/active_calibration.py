"""Which calibration is in force: one small file, replaced in one step."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from device.calibration_bundle import CalibrationBundle, read_calibration
from device.durable import replace_file
from device.errors import NoCalibration
from device.records import BundleId, Record, decode_record, encode_record, read_small
from device.store_access import FILE_MODE

ACTIVE_FILE: Final = "active.json"
ACTIVE_SCHEMA: Final = "retrograph.active/1"
_REMEDY: Final = (
    "put a calibration in force again with `retroscan shelf use ID` (`retroscan shelf` lists them), or run "
    "`retroscan calibrate`"
)


class ActiveCalibration(Record, frozen=True, tag_field="schema", tag=ACTIVE_SCHEMA):
    """The id of the calibration in force."""

    calibration_id: BundleId


def read_active(root: Path) -> CalibrationBundle:
    """The calibration in force in a store.

    Raises
    ------
    NoCalibration
        None was activated, or the active one is gone.
    RecordError
        The choice or the calibration is damaged.
    """
    path = root / ACTIVE_FILE
    if not path.exists():
        raise NoCalibration(f"no calibration is active in {root}: run `retroscan calibrate` first")
    calibration_id = decode_record(
        read_small(path, f"remove it, then {_REMEDY}"), ActiveCalibration, path, _REMEDY
    ).calibration_id
    directory = root / "calibrations" / calibration_id
    if not directory.is_dir():
        raise NoCalibration(f"the active calibration {calibration_id} is gone: run `retroscan calibrate` again")
    return read_calibration(directory)


def write_active(root: Path, calibration_id: str) -> None:
    """Put a calibration in force, durably.

    Raises
    ------
    OSError
        The disk refused; the one before stays in force.
    """
    replace_file(root / ACTIVE_FILE, encode_record(ActiveCalibration(calibration_id=calibration_id)), FILE_MODE)
