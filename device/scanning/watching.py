"""Scanning at every push of the button: cues, a long push, and pushes that come while busy."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Final

from device.bundle_store import BundleStore
from device.errors import DeviceError
from device.scan_bundle import Annotations
from device.scanning.scanner import Scanner, ScanOutcome
from device.scanning.supervision import Supervisor
from hal.errors import HalError
from hal.hardware import Hardware
from hal.interfaces import Cue

LONG_PUSH_S: Final = 2.0
"""A button held this long asks for something else than a scan."""


def watch(
    hardware: Hardware,
    store: BundleStore,
    annotations: Annotations,
    report: Callable[[ScanOutcome], None],
    complain: Callable[[object], None],
    tell: Callable[[str], None],
    supervisor: Supervisor,
) -> None:
    """Scan at every push until the button says no more; what fails is complained of, and the next push is heard.

    supervisor : is told when the loop begins and in each of its turns, and how it is watched bounds each wait

    Raises
    ------
    DeviceError
        No scan is possible at all: no calibration, or no room.
    HalError
        The button cannot be read any more.
    """
    scanner = Scanner(hardware, store)
    room = f"room for {scanner.check_room()} scans"
    tell(f"Ready: {room}. Push the button to scan, Ctrl-C to stop.")
    _show(hardware, "idle")
    supervisor.ready(f"ready, {room}")
    while True:
        press = hardware.button.wait_for_press(supervisor.longest_wait_s)
        supervisor.alive()
        if press is None:
            continue
        if press.held_s >= LONG_PUSH_S:
            tell(f"Held {press.held_s:.0f} s, no scan. {_state(hardware, scanner)}")
            continue
        try:
            _show(hardware, "busy")
            outcome = scanner.scan(annotations, lambda: _show(hardware, "may lift"))
        except (DeviceError, HalError) as error:
            complain(error)
            _show(hardware, "refused")
        else:
            report(outcome)
            _show(hardware, outcome.bundle.record.verdict.level)
        if missed := hardware.button.forget_presses():
            complain(f"{missed} push(es) came while busy and did nothing: push again when the indicator is off")
            _show(hardware, "refused")


def _show(hardware: Hardware, cue: Cue) -> None:
    """Play a cue; an indicator that fails never costs a scan."""
    with suppress(HalError):
        hardware.indicator.show(cue)


def _state(hardware: Hardware, scanner: Scanner) -> str:
    """Room and battery in a sentence."""
    try:
        reading = hardware.power.read()
        room = scanner.check_room()
    except (DeviceError, HalError) as error:
        return str(error)
    battery = "" if reading.battery_share is None else f" Battery {reading.battery_share:.0%}."
    return f"Room for {room} scans.{battery}"
