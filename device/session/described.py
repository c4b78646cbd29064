"""Calibration and gel as the state describes them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from device.active_calibration import ACTIVE_FILE
from device.bundle_store import BundleStore
from device.calibration_bundle import CalibrationBundle
from device.calibration_shelf import CalibrationShelf
from device.errors import DeviceError
from device.exposure_levels import Brightness
from device.gel_log import mounted_gel
from device.session.state import CalibrationState, GelState, InstrumentState
from hal.hardware import Hardware

Choice = tuple[str, float, bytes]
"""Gel that is mounted, its slab in mm, and the store's word on which calibration is in force."""


def choice_of(store: BundleStore, hardware: Hardware) -> Choice:
    """What the store says is mounted and in force, as it stands on the disk now."""
    gel, word = gel_state(store.root, hardware), b""
    with suppress(OSError):
        word = (store.root / ACTIVE_FILE).read_bytes()
    return gel.gel_id, gel.slab_thickness_mm, word


def calibration_state(calibration: CalibrationBundle, shelf: CalibrationShelf, store: BundleStore) -> CalibrationState:
    """The calibration in force. Errors as for `CalibrationShelf.entry_in_force`."""
    record = calibration.record
    entry = shelf.entry_in_force()
    return CalibrationState(
        calibration_id=record.calibration_id,
        gel_id=record.gel_id,
        version=entry.version if entry else None,
        slot=entry.slot if entry else None,
        age_s=calibration_age_s(calibration, store),
        held_out_deg=record.figures.get("held_out_error_deg"),
        brightness=Brightness.of_figures(record.figures),
    )


def calibration_age_s(calibration: CalibrationBundle, store: BundleStore) -> float | None:
    """How old a calibration is by the wall clock; None when that clock says something impossible."""
    age_s = (store.wall_time() - calibration.record.created).total_seconds()
    return age_s if age_s >= 0.0 else None


def standing(state: InstrumentState) -> str:
    """Room, battery and complaints in sentences, each with a blank before it."""
    room = "" if state.scans_left is None else f" Room for {state.scans_left} scans."
    battery = "" if state.power.battery_share is None else f" Battery {state.power.battery_share:.0%}."
    return room + battery + "".join(f" {complaint}." for complaint in state.power.complaints)


def gel_state(root: Path, hardware: Hardware) -> GelState:
    """The mounted gel; the board's own while the store's word on it is damaged, which `Scanner` then refuses."""
    facts = hardware.profile.gel
    try:
        gel = mounted_gel(root, facts)
    except DeviceError:
        return GelState(facts.id, facts.slab_thickness_mm, 0)
    return GelState(gel.gel_id, gel.slab_thickness_mm, gel.presses)
