"""The line that is always there: room, battery, calibration, gel, and whether all is well."""

from __future__ import annotations

from device.session.state import CalibrationState, InstrumentState
from device.tui.words import age_text, share_text, shortened
from hal.interfaces import PowerReading


def state_text(state: InstrumentState, columns: int) -> str:
    """What matters most first; what does not fit is left out."""
    parts = [_room(state), _battery(state.power), calibration_text(state.calibration), f"gel {state.gel.gel_id}"]
    if state.processing:
        parts.insert(1, f"{state.processing} in work")
    if state.health.level != "good" and state.health.sentence:
        parts.insert(0, f"! {state.health.sentence}")
    return shortened(" · ".join(part for part in parts if part), columns)


def calibration_text(calibration: CalibrationState) -> str:
    """The age of the calibration in force, such as "calibrated 3 h ago"."""
    if calibration.calibration_id is None:
        return "not calibrated"
    if calibration.age_s is None:
        return "calibrated, age unknown"
    old = ", check it" if calibration.is_old else ""
    return f"calibrated {age_text(calibration.age_s)}{old}"


def _room(state: InstrumentState) -> str:
    return "" if state.scans_left is None else f"{state.scans_left} scans left"


def _battery(power: PowerReading) -> str:
    if power.under_voltage:
        return "! supply too low"
    return "" if power.battery_share is None else f"battery {share_text(power.battery_share)}"
