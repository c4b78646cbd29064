"""The mounted gel: the board profile with it, and exposure and light currents of its next calibration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from device.acquisition.capture import CaptureSettings
from device.bundles.fingerprint import SettingsRecord
from device.store.choices import BALANCE, BalanceRecord, mounted_gel
from hal.board_profile import BoardProfile, GelConfig
from hal.hardware import Hardware


def with_active_gel(hardware: Hardware, root: Path) -> Hardware:
    """Return the same devices, with the mounted gel in the profile instead of the board's default gel.

    Raises
    ------
    RecordError
        The store's gel record is damaged.
    """
    return replace(hardware, profile=profile_with_mounted_gel(hardware.profile, root))


def profile_with_mounted_gel(profile: BoardProfile, root: Path) -> BoardProfile:
    """Return the board profile with the mounted gel. Errors as for `with_active_gel`."""
    gel = mounted_gel(root, profile.gel)
    mounted = GelConfig(id=gel.gel_id, slab_thickness_mm=gel.slab_thickness_mm)
    return msgspec.structs.replace(profile, gel=mounted)


def calibration_settings(hardware: Hardware, root: Path) -> CaptureSettings:
    """Return what the next calibration is taken with; a balance of another gel, board or other lights does not count.

    hardware : with the mounted gel
    """
    usual, balance = CaptureSettings.of_board(hardware), BALANCE.read_sound(root)
    if balance is None or (balance.board, balance.gel_id) != (hardware.profile.name, hardware.profile.gel.id):
        return usual
    if set(balance.currents_ma) != set(hardware.lights.names):
        return usual
    asked_ma = {name: balance.currents_ma[name] for name in hardware.lights.names}
    return CaptureSettings(balance.settings.settings, hardware.lights.granted_ma(asked_ma))


def keep_balance(hardware: Hardware, root: Path, plan: CaptureSettings) -> None:
    """Take later calibrations of this gel with these settings. Errors as for `RecordFile.write`."""
    balance = BalanceRecord(
        board=hardware.profile.name,
        gel_id=hardware.profile.gel.id,
        settings=SettingsRecord.of(plan.settings),
        currents_ma=dict(plan.currents_ma),
    )
    BALANCE.write(root, balance)
