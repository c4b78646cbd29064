"""Record of the active calibration: one small file, replaced in one step."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from device.bundles.calibration import CalibrationBundle, read_calibration
from device.bundles.record import BundleId, Record, decode_record, encode_record, read_small
from device.errors import NoCalibration
from device.io.atomic import replace_file
from device.io.permissions import FILE_MODE

ACTIVE_FILE: Final = "active.json"
ACTIVE_SCHEMA: Final = "retrograph.active/1"
_REMEDY: Final = (
    "activate a calibration again with `retroscan calibrations use ID` (`retroscan calibrations` lists them), or run "
    "`retroscan calibrate`"
)


class ActiveCalibration(Record, frozen=True, tag_field="schema", tag=ACTIVE_SCHEMA):
    """The id of the active calibration."""

    calibration_id: BundleId


def read_active(root: Path) -> CalibrationBundle:
    """Return the active calibration of a store.

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
    """Make a calibration the active one, durably.

    Raises
    ------
    OSError
        The disk refused; the one before stays active.
    """
    replace_file(root / ACTIVE_FILE, encode_record(ActiveCalibration(calibration_id=calibration_id)), FILE_MODE)
