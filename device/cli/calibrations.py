"""`retroscan gel`, `calibrations` and lists: the mounted gel, and the calibrations made for each gel."""

from __future__ import annotations

from typing import Any, Literal

from device.acquisition.scanner import BYTES_PER_PIXEL
from device.cli.console import Given, Options, open_store, print_line
from device.command_line import Folder, print_json
from device.errors import DeviceError, NoCalibration
from device.instrument.history import ScanEntry, read_history
from device.store.choices import known_gel, known_gels, make_gel, mount_gel, mounted_gel, profile_with_mounted_gel
from device.store.deletion import acknowledged_scans
from device.store.registry import CalibrationRegistry
from device.store.registry_file import SHORT
from device.store.store import BundleStore
from device.store.transfers import InboxItem
from device.tui.drawing.text import local_time
from hal.board_profile import load_board_profile


def show_or_mount_gel(gel_id: str | None = None, /, *, slab_mm: float | None = None, options: Given) -> int:
    """Show or change the mounted gel; its calibration becomes active.

    Parameters
    ----------
    gel_id
        Name of the gel that is mounted now.
    slab_mm
        Slab thickness of a new gel, mm; by default from the board profile.
    """
    store, default = open_store(options), load_board_profile(options.board).gel
    if gel_id is None:
        mounted = mounted_gel(store.root, default)
        known = {gel.gel_id: gel for gel in (*known_gels(store.root), mounted)}
        for gel in known.values():
            mark = "  (mounted)" if gel.gel_id == mounted.gel_id else ""
            print_line(f"{gel.gel_id}: slab {gel.slab_thickness_mm:g} mm, {gel.presses} presses{mark}")
        return 0
    _registry(options, store).list()  # records the active calibration for the gel that is taken off
    known_one = known_gel(store.root, gel_id) if slab_mm is None else None
    new_mm = default.slab_thickness_mm if slab_mm is None else slab_mm
    mount_gel(store.root, known_one or make_gel(gel_id, new_mm))
    print_line(f"Gel {gel_id} is mounted.")
    try:
        entry = _registry(options, store).switch()
    except NoCalibration as error:
        print_line(f"Scanning is not possible yet: {error}")
        return 0
    print_line(f"Calibration {entry.calibration_id} (version {entry.version}) is active.")
    return 0


def list_calibrations(options: Options) -> int:
    """List the calibrations."""
    store = open_store(options)
    found = _registry(options, store).list()
    if not found:
        print_line(
            f"no calibrations in {store.root}: run `retroscan calibrate` or `retroscan calibrations import FOLDER`"
        )
    for registered in found:
        record, entry = registered.bundle.record, registered.entry
        mark = "  (active)" if registered.active else ""
        error_deg = record.figures.get("held_out_error_deg")
        error = "" if error_deg is None else f", held-out error {error_deg:.2f} degrees"
        print_line(
            f"{record.gel_id} on {record.board}, version {entry.version} ({entry.slot}), {record.created:%Y-%m-%d}"
            f"{error}, content {entry.content[:SHORT]}: {entry.calibration_id}{mark}"
        )
    for damaged in store.calibrations().damaged:
        print_line(f"damaged: {damaged.reason}")
    return 0


def use_calibration(calibration_id: str, /, *, options: Given) -> int:
    """Activate a calibration.

    Parameters
    ----------
    calibration_id
        Its id, as `retroscan calibrations` lists it.
    """
    entry = _registry(options, open_store(options)).activate(calibration_id)
    print_line(f"Calibration {entry.calibration_id} (version {entry.version}) is active.")
    return 0


def roll_back(*, options: Given) -> int:
    """Activate the previous version."""
    entry = _registry(options, open_store(options)).roll_back()
    print_line(f"Rolled back to version {entry.version} ({entry.slot}): calibration {entry.calibration_id} is active.")
    return 0


def import_calibration(
    folder: Folder,
    /,
    *,
    slot: Literal["user", "factory"] = "user",
    adopt: bool = False,
    use: bool = False,
    options: Given,
) -> int:
    """Copy a calibration folder into the store.

    Parameters
    ----------
    folder
        The calibration folder.
    slot
        Rollbacks end at the factory calibration.
    adopt
        Accept one made by this instrument under an earlier id.
    use
        Activate it too.
    """
    registry = _registry(options, open_store(options))
    entry = registry.import_(folder, slot, adopt=adopt)
    print_line(f"Calibration {entry.calibration_id} is imported as version {entry.version} ({entry.slot}).")
    if use:
        registry.activate(entry.calibration_id)
        print_line("It is active.")
    return 0


def export_calibration(calibration_id: str, folder: Folder, /, *, options: Given) -> int:
    """Copy a calibration into a folder.

    Parameters
    ----------
    calibration_id
        Its id, as `retroscan calibrations` lists it.
    folder
        Destination; the calibration folder is created in it.
    """
    copied_to = _registry(options, open_store(options)).export(calibration_id, folder)
    print_line(f"Copied to {copied_to}.")
    return 0


def _registry(options: Options, store: BundleStore) -> CalibrationRegistry:
    profile = load_board_profile(options.board)
    return CalibrationRegistry(store, profile_with_mounted_gel(profile, store.root))


# Contents of the store, without opening hardware: `retroscan status` and `retroscan list`, as sentences or JSON.


def show_status(*, json: bool = False, options: Given) -> int:
    """Show calibration, gel and room for scans; opens no hardware.

    Parameters
    ----------
    json
        Print one JSON document instead of sentences.
    """
    store, profile = open_store(options), load_board_profile(options.board)
    fitted = profile_with_mounted_gel(profile, store.root)
    stored = store.scans()
    calibration_id, fault = None, ""
    try:
        active = store.active_calibration()
        calibration_id = active.calibration_id
        if active.record.gel_id != fitted.gel.id:
            fault = f"calibration {calibration_id} is of gel {active.record.gel_id}: run `retroscan calibrate` first"
    except DeviceError as error:
        fault = str(error)
    bytes_per_scan = int(BYTES_PER_PIXEL * profile.sensor.rows * profile.sensor.columns)
    facts = {
        "device_id": store.device_id,
        "board": profile.name,
        "gel": fitted.gel.id,
        "calibration": calibration_id,
        "calibration_fault": fault,
        "scans": len(stored.bundles),
        "scans_sent": len(acknowledged_scans(store.root)),
        "scans_damaged": len(stored.damaged),
        "scans_left": store.scans_left(bytes_per_scan),
        "store": str(store.root),
    }
    if json:
        print_json(facts)
        return 0
    print_line(f"{facts['device_id']} ({profile.name}), gel {fitted.gel.id}")
    print_line(fault or f"Calibration {calibration_id} is active.")
    print_line(
        f"{facts['scans']} scans, {facts['scans_sent']} of them sent, {facts['scans_damaged']} damaged; room for "
        f"{facts['scans_left']} more in {store.root}"
    )
    return 0


def list_scans(*, json: bool = False, options: Given) -> int:
    """List the scans on this device, newest first.

    Parameters
    ----------
    json
        Print one JSON document instead of sentences.
    """
    history = read_history(open_store(options))
    if json:
        print_json({"scans": [_facts(scan) for scan in history.scans], "damaged": history.damaged})
        return 0
    for scan in history.scans:
        sent, part = (
            " (sent)" if scan.offloaded else "",
            f", part {scan.annotations.part}" if scan.annotations.part else "",
        )
        time = local_time(scan.wall_time)
        print_line(f"#{scan.counter} {time} {scan.verdict.level}: {scan.verdict.reason}{part}{sent} ({scan.scan_id})")
    for reason in history.damaged:
        print_line(f"damaged: {reason}")
    if not history.scans and not history.damaged:
        print_line("no scans yet")
    return 0


def _facts(scan: ScanEntry) -> dict[str, Any]:
    return {
        "scan": scan.scan_id,
        "counter": scan.counter,
        "time": scan.wall_time,
        "gel": scan.gel_id,
        "calibration": scan.calibration_id,
        "verdict": scan.verdict,
        "annotations": scan.annotations,
        "sent": scan.offloaded,
        "mark": scan.mark,
    }


def print_imports(store: BundleStore) -> list[InboxItem]:
    """Import the pushed calibrations, print the outcome of each, and return them."""
    items = store.import_inbox()
    for item in items:
        print_line(f"{item.name}: {item.refusal or 'imported'}")
    return items


def import_pushed(*, activate: bool = False, options: Given) -> int:
    """Import the calibrations that a workstation pushed.

    Parameters
    ----------
    activate
        Activate the last one imported.
    """
    store = open_store(options)
    items = print_imports(store)
    imported = [item.name for item in items if item.refusal is None]
    if activate and imported:
        print_line(f"Calibration {store.activate(imported[-1]).calibration_id} is active.")
    return 2 if len(imported) < len(items) else 0
