"""Contents of the store, without opening hardware: `retroscan status` and `retroscan list`, as sentences or JSON."""

from __future__ import annotations

from typing import Any

from device.acquisition.gel_profile import profile_with_mounted_gel
from device.acquisition.scanner import BYTES_PER_PIXEL
from device.cli.console import Given, open_store, print_line
from device.command_line import print_json
from device.errors import DeviceError
from device.instrument.history import ScanEntry, read_history
from device.store.deletion import acknowledged_scans
from device.tui.drawing.text import local_time
from hal.board_profile import load_board_profile


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
        calibration_id = store.active_calibration().calibration_id
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
