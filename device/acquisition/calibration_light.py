"""Exposure and light currents of the next calibration: those of an exposure balance, else the board profile's."""

from __future__ import annotations

from pathlib import Path

from device.acquisition.capture import CaptureSettings
from device.bundles.fingerprint import SettingsRecord
from device.store.choices import BALANCE, BalanceRecord
from hal.hardware import Hardware


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
