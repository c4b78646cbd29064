"""Exposure and light currents that an exposure balance found for a gel: the next calibration is made with them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import msgspec

from device.bundles.fingerprint import SettingsRecord
from device.bundles.record import BundleId, Positive, Record, ShortText, decode_record, encode_record, read_small
from device.errors import RecordError, StoreError
from device.io.atomic import replace_file
from device.io.os_errors import explain_os_error

BALANCE_FILE: Final = "exposure-balance.json"
_REMEDY: Final = "remove it, and balance the exposure again"


class BalanceRecord(Record, frozen=True, tag_field="schema", tag="retrograph.exposure-balance/1"):
    """Exposure and currents for the next calibration of a gel on a board.

    currents_ma : of each light by its name, mA
    """

    board: ShortText
    gel_id: BundleId
    settings: SettingsRecord
    currents_ma: Annotated[dict[ShortText, Positive], msgspec.Meta(min_length=3, max_length=3)]


def read_balance(root: Path) -> BalanceRecord | None:
    """The last exposure balance; None when there is none or its file is damaged."""
    path = root / BALANCE_FILE
    if not path.exists():
        return None
    try:
        return decode_record(read_small(path, _REMEDY), BalanceRecord, path, _REMEDY)
    except RecordError:
        return None


def write_balance(root: Path, balance: BalanceRecord) -> None:
    """Store it durably.

    Raises
    ------
    StoreError
        The disk refused; the one before is kept.
    """
    path = root / BALANCE_FILE
    try:
        replace_file(path, encode_record(balance))
    except OSError as error:
        raise StoreError(f"{path}: cannot be stored {explain_os_error(error)}") from error


def remove_balance(root: Path) -> None:
    """Take the board profile's exposure and currents for the next calibration again.

    Raises
    ------
    StoreError
        The disk refused.
    """
    path = root / BALANCE_FILE
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(f"{path}: cannot be removed {explain_os_error(error)}") from error
