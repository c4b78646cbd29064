"""Calibration and gel as the state describes them."""

from __future__ import annotations

from pathlib import Path

from device.bundle_store import BundleStore
from device.calibration_bundle import CalibrationBundle
from device.calibration_shelf import CalibrationShelf
from device.errors import DeviceError
from device.gel_log import mounted_gel
from device.session.state import CalibrationState, GelState
from hal.hardware import Hardware


def calibration_state(calibration: CalibrationBundle, shelf: CalibrationShelf, store: BundleStore) -> CalibrationState:
    """The calibration in force. Errors as for `CalibrationShelf.entry_in_force`."""
    record = calibration.record
    entry = shelf.entry_in_force()
    age_s = (store.wall_time() - record.created).total_seconds()
    return CalibrationState(
        calibration_id=record.calibration_id,
        gel_id=record.gel_id,
        version=entry.version if entry else None,
        slot=entry.slot if entry else None,
        age_s=age_s if age_s >= 0.0 else None,
        held_out_deg=record.figures.get("held_out_error_deg"),
    )


def gel_state(root: Path, hardware: Hardware) -> GelState:
    """The mounted gel; the board's own while the store's word on it is damaged, which `Scanner` then refuses."""
    facts = hardware.profile.gel
    try:
        gel = mounted_gel(root, facts)
    except DeviceError:
        return GelState(facts.id, facts.slab_thickness_mm, 0)
    return GelState(gel.gel_id, gel.slab_thickness_mm, gel.presses)
